# SPDX-License-Identifier: Apache-2.0
"""Gels of a study's designs, and the steps of their presses as states of the contact face."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.inner_path import inner_path
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.viewer.gel_states import GelStates

_NEEDED = ("depth_mm", "force_n", "contact_rest_m", "contact_moved_m", "contact_faces")


def design_gel(row: DesignRow) -> GelStates:
    """The untouched gel of a design, at the resolution of profiles."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.sensors.registry import sensor_family

    mesh = gel_mesh(sensor_family(row.family).parameters(row.parameters).pad())
    rest = 1e3 * mesh.nodes_m
    return GelStates(
        rest_mm=rest,
        tets=mesh.tets.astype(np.int64),
        faces=mesh.faces.astype(np.int64),
        moved_mm=np.zeros((1, *rest.shape)),
        captions=["untouched"],
    )


def press_files(root: Path, row: DesignRow) -> dict[str, Path]:
    """The presses that a design's folder keeps, by name."""
    folder = root / "designs" / row.id
    found = sorted(path.relative_to(root).as_posix() for path in folder.glob("press_*.npz"))
    paths = [inner_path(root, name) for name in found]
    return {path.stem.removeprefix("press_"): path for path in paths}


def read_design_press(path: Path) -> GelStates:
    """The contact face at rest and after each step of a press of a study.

    Raises InputError for a file that is not one, or that has no step.
    """
    arrays = read_npz(path, _NEEDED)
    moved = 1e3 * finite_numbers(arrays, "contact_moved_m", path)
    if len(moved) == 0:
        raise InputError(f"{path}: no step of this press converged")
    depths, forces = (finite_numbers(arrays, name, path) for name in ("depth_mm", "force_n"))
    if depths.shape != moved.shape[:1] or forces.shape != (*depths.shape, 3):
        raise InputError(f"{path}: its depths and forces are not those of {len(moved)} steps")
    captions = [
        f"depth {depth:.2f} mm, force {force[2]:.3f} N along the press"
        for depth, force in zip(depths, forces, strict=True)
    ]
    return GelStates(
        rest_mm=1e3 * finite_numbers(arrays, "contact_rest_m", path),
        tets=np.zeros((0, 4), dtype=np.int64),
        faces=arrays["contact_faces"].astype(np.int64),
        moved_mm=np.concatenate([np.zeros_like(moved[:1]), moved]),
        captions=["untouched", *captions],
    ).checked(path)
