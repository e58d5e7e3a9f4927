# SPDX-License-Identifier: Apache-2.0
"""Prims that the layers of a USD file stand for, counted before a stage makes them: thirty doubled
references are a thousand million.

https://openusd.org/release/glossary.html#livrps-strength-ordering
"""

from __future__ import annotations

import os
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few, require_few_copies
from taccel_lab.newton_bridge.mjcf_understood import MAX_BODIES, MAX_GEOMS
from taccel_lab.newton_bridge.usd_schemas import applied

MAX_PRIMS = 20_000
"""Most prims of a stage; a humanoid with its looks has 1,000."""
_Place = tuple[int, str]
"""A stack of layers and the path of a prim in it."""


def require_few_prims(path: Path, layers: Sequence[Any]) -> None:
    """Refuse a stage of more prims, bodies or shapes than are read, each as often as it is shown.

    Args:
        path: The file.
        layers: All layers, ``Sdf.Layer``; the first one is the file's own.

    Raises InputError for more, and for prims that are made of themselves.
    """
    stage = _Stage(path, layers)
    roots = [place for place in stage.parts if place[0] == stage.stack_of[0] and _is_root(place)]
    limits = {"prims": MAX_PRIMS, "bodies": MAX_BODIES, "shapes": MAX_GEOMS}
    parts: dict[Hashable, list[Hashable]] = {}
    for place, children in stage.parts.items():
        parts[place] = [*children, *(one for of in stage.sources[place] for one in stage.found(of))]
    for what, own in stage.own.items():
        counted: dict[Hashable, int] = {**own}
        require_few_copies(path, parts, roots, limits[what], own=counted, what=what)


def _is_root(place: _Place) -> bool:
    return place[1].count("/") == 1


class _Stage:
    """Prims of all layers, and what each is made of."""

    def __init__(self, path: Path, layers: Sequence[Any]) -> None:
        self._path = path
        self._files = {os.path.realpath(layer.realPath): k for k, layer in enumerate(layers)}
        self.stack_of = list(range(len(layers)))
        """Stack of each layer: layers that lie over one another have one."""
        for k, layer in enumerate(layers):
            for name in layer.subLayerPaths:
                old, new = self.stack_of[self._file(layer, name)], self.stack_of[k]
                self.stack_of = [new if stack == old else stack for stack in self.stack_of]
        self.parts: dict[_Place, set[_Place]] = {}
        """Children of prims that stand in a layer."""
        self.sources: dict[_Place, list[_Place]] = {}
        """Prims that a prim refers to or inherits from."""
        self.own: dict[str, dict[_Place, int]] = {"prims": {}, "bodies": {}, "shapes": {}}
        """Count of each prim by itself."""
        self._names = 0
        for k, layer in enumerate(layers):
            for spec in _prims(layer):
                self._add(layer, layers, k, spec)

    def _file(self, layer: Any, name: str) -> int:
        return self._files[os.path.realpath(layer.ComputeAbsolutePath(name))]

    def _add(self, layer: Any, layers: Sequence[Any], k: int, spec: Any) -> None:
        stack = self.stack_of[k]
        # What a variant adds lies in the prim, whichever of them is chosen.
        place = (stack, str(spec.path.StripAllVariantSelections()))
        children = self.parts.setdefault(place, set())
        for child in spec.nameChildren:
            children.add((stack, str(child.path.StripAllVariantSelections())))
        sources = self.sources.setdefault(place, [])
        for key in ("references", "payload"):
            for arc in spec.GetInfo(key).GetAppliedItems() if spec.HasInfo(key) else ():
                other = self._file(layer, arc.assetPath) if arc.assetPath else k
                target = str(arc.primPath) or f"/{layers[other].defaultPrim.lstrip('/')}"
                sources.append((self.stack_of[other], target))
        for key in ("inheritPaths", "specializes"):
            for target in spec.GetInfo(key).GetAppliedItems() if spec.HasInfo(key) else ():
                sources.append((stack, str(target)))
        schemas = applied(spec)
        marks = {
            "prims": True,
            "bodies": "PhysicsRigidBodyAPI" in schemas,
            "shapes": "PhysicsCollisionAPI" in schemas,
        }
        for what, own in self.own.items():
            own[place] = max(own.get(place, 0), int(marks[what]))

    def found(self, place: _Place) -> list[_Place]:
        """Prims of layers that a path stands for: its own, and those that it gets because a prim
        above it refers to others."""
        result, seen, waiting = [], {place}, [place]
        while waiting:
            one = waiting.pop()
            if one in self.parts:
                result.append(one)
            new = [inner for inner in self._inherited(one) if inner not in seen]
            seen.update(new)
            waiting += new
            self._names += len(new)
            require_few(self._path, "names of prims", self._names, 10 * MAX_PRIMS)
        return result

    def _inherited(self, place: _Place) -> Iterator[_Place]:
        stack, path = place
        above = path.rpartition("/")[0]
        while above:
            rest = path[len(above) :]
            for other, target in self.sources.get((stack, above), ()):
                if len(target) + len(rest) > MAX_PATH:
                    raise InputError(f"{self._path}: prims of it are made of themselves")
                yield other, target + rest
            above = above.rpartition("/")[0]


MAX_PATH = 4096
"""Most characters of the path of a prim."""


def _prims(layer: Any) -> Iterator[Any]:
    """All prims of a layer, those of variants, too."""
    paths: list[Any] = []
    layer.Traverse(layer.pseudoRoot.path, paths.append)
    for path in paths:
        is_prim = path.IsPrimPath() or path.IsPrimVariantSelectionPath()
        if is_prim and (spec := layer.GetPrimAtPath(path)) is not None:
            yield spec
