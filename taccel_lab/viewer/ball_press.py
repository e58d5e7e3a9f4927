# SPDX-License-Identifier: Apache-2.0
"""A ball on a design page and what it gave; without solver and Warp, so that a page opens at once.

``design_press`` simulates it. The default press of a design of the catalogue is kept from one run
to the next: a page that opens shows it before the solver is even loaded.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

import taccel_lab
from taccel_lab.cad.parts.dome_pad import DomePad
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import CachedFile, load_arrays, save_arrays, source_digest
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.presses.bonded_layer import layer_force_n

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters


DEPTH_SHARE = 0.4
"""Deepest press of the page, as a part of the gel's thickness."""


class SupersededError(Exception):
    """A newer wish has come; what is under way is of no use any more."""


@dataclass(frozen=True)
class BallPress:
    """A ball pressed into the middle of the gel."""

    radius_mm: float = 3.0
    depth_mm: float = 0.5

    def limited(self, thickness_mm: float) -> BallPress:
        """Press no deeper than the page presses a gel of that thickness."""
        return replace(self, depth_mm=min(self.depth_mm, DEPTH_SHARE * thickness_mm))


@dataclass(frozen=True)
class PressAnswer:
    """What a press gave."""

    force_n: float
    error_n: float
    """Estimated error of the force; NaN where there is no estimate."""
    mesh: TetMesh | QuadraticMesh
    positions_m: np.ndarray
    """[node, 3]."""
    pressures_pa: np.ndarray
    """[node]."""
    forces_n: np.ndarray
    """Forces of the ball on the nodes, [node, 3]."""
    von_mises_pa: np.ndarray
    """[node]."""
    ball_mm: np.ndarray
    """Middle of the ball at the end, [3]."""


def formula_force_n(parameters: FamilyParameters, press: BallPress) -> float:
    """Force by the exact linear solution of a bonded flat layer [N], see ``layer_force_n``: without
    friction, crown or rim; NaN for domes."""
    pad, gel = parameters.pad(), parameters.material()
    if isinstance(pad, DomePad):
        return math.nan
    found = layer_force_n(
        "sphere",
        np.array([press.depth_mm]),
        press.radius_mm,
        pad.thickness_mm,
        gel.poisson_ratio,
        gel.young_modulus_pa,
    )
    return float(found[0])


def height_profile_mm(
    answer: PressAnswer, positions_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """x and z [mm] of the contact face along y = 0, by ascending x; ``positions_m``: [node, 3]."""
    faces = answer.mesh.region_faces(Region.CONTACT)
    points = 1e3 * positions_m
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    first, second = points[edges[:, 0]], points[edges[:, 1]]
    # A hair beside the middle, where rows of nodes lie.
    below, above = first[:, 1] - 1e-6, second[:, 1] - 1e-6
    crossing = below * above < 0
    share = (below / np.where(crossing, below - above, 1.0))[crossing, None]
    found = first[crossing] + share * (second[crossing] - first[crossing])
    order = np.argsort(found[:, 0])
    return found[order, 0], found[order, 2]


def scaled(answer: PressAnswer, factor: float) -> PressAnswer:
    """The press of a gel whose moduli are all ``factor`` times these: the same shape, and all loads
    times that factor, as nothing else in a press has the dimension of a stress."""
    if not factor > 0:
        raise InputError("moduli must be above 0")
    return replace(
        answer,
        force_n=factor * answer.force_n,
        error_n=factor * answer.error_n,
        pressures_pa=factor * answer.pressures_pa,
        forces_n=factor * answer.forces_n,
        von_mises_pa=factor * answer.von_mises_pa,
    )


SOURCES = (
    "bodies", "cad", "geometry", "ipc", "model", "outputs", "presses", "scene",
    "sensors", "signals", "solvers", "state.py", "viewer/ball_press.py", "viewer/design_press.py",
)  # fmt: skip
"""Code of this package that presses are made by."""
_LIBRARIES = ("numpy", "scipy", "warp-lang")
_BASE, _MESH = "base.", "mesh."


def kept_press(key: Any) -> CachedFile[PressAnswer]:
    """The file of a press; ``key``: its design and load, whose ``repr`` says all of them."""
    root = Path(taccel_lab.__file__).parent
    recipe = {
        "solver": source_digest(*(str(root / name) for name in SOURCES)),
        "libraries": [version(name) for name in _LIBRARIES],
        "press": repr(key),
    }
    return CachedFile("presses", recipe, _load, _save)


def _save(file: BinaryIO, press: PressAnswer) -> None:
    mesh = press.mesh
    arrays = _arrays(press, "")
    if isinstance(mesh, QuadraticMesh):
        arrays |= _arrays(mesh, _MESH)
        mesh = mesh.base
    save_arrays(file, {**arrays, **_arrays(mesh, _BASE)})


def _load(file: BinaryIO) -> PressAnswer:
    arrays = load_arrays(file)
    base, middles = _taken(arrays, _BASE), _taken(arrays, _MESH)
    mesh: TetMesh | QuadraticMesh = TetMesh(**base)
    if middles:
        mesh = QuadraticMesh(mesh, **middles)
    force_n, error_n = float(arrays.pop("force_n")), float(arrays.pop("error_n"))
    return PressAnswer(force_n=force_n, error_n=error_n, mesh=mesh, **arrays)


def _arrays(value: Any, prefix: str) -> dict[str, np.ndarray]:
    """Fields that are numbers or arrays; meshes within stand by themselves."""
    found = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return {
        prefix + name: np.asarray(field)
        for name, field in found.items()
        if isinstance(field, (float, np.ndarray))
    }


def _taken(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {
        name.removeprefix(prefix): arrays.pop(name)
        for name in list(arrays)
        if name.startswith(prefix)
    }
