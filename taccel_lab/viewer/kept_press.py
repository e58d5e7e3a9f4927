# SPDX-License-Identifier: Apache-2.0
"""The default press of a design of the catalogue, kept from one run to the next.

A page that opens shows it before the solver is even loaded.
"""

from __future__ import annotations

import dataclasses
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import taccel_lab
from taccel_lab.files.file_cache import CachedFile, load_arrays, save_arrays, source_digest
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.viewer.ball_press import PressAnswer

SOURCES = (
    "bodies", "cad", "geometry", "ipc", "model", "outputs", "presses", "scene",
    "sensors", "signals", "solvers", "state.py", "viewer/ball_press.py", "viewer/design_press.py",
)  # fmt: skip
"""Of this package, the code that presses are made by."""
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
