# SPDX-License-Identifier: Apache-2.0
"""Bodies that the files of tasks describe; it reads no files, and so needs no pydantic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    SoftBody,
    TriangleMesh,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)

if TYPE_CHECKING:
    from taccel_lab.tasks.parameters import FreeBody, PadParameters


def pad_mesh(pad: PadParameters) -> TetMesh:
    """Its contact face at z = 0, the bond below."""
    width, height, thickness = (1e-3 * side for side in pad.size_mm)
    cells = (pad.cells[0], pad.cells[1], pad.cells[2])
    if pad.focus == 0:
        return block_mesh(cells, (width, height, thickness), pad.jitter, seed=4)
    unit = block_mesh(cells, (2.0, 2.0, 1.0), pad.jitter, seed=4)
    graded = np.sinh(pad.focus * unit.nodes_m) / np.sinh(pad.focus)
    return labelled(graded * [width / 2, height / 2, thickness], unit.tets)


def pad_body(
    pad: PadParameters, mesh: TetMesh, name: str = "gel", mount: str | None = None
) -> SoftBody:
    """The gel, in its own frame, or in that of its mount."""
    return SoftBody(
        mesh,
        Material(pad.young_modulus_pa, pad.poisson_ratio, pad.density_kg_m3),
        name=name,
        mount=mount,
        friction_coefficient=pad.friction,
        element=Element(pad.element),
    )


def free_body(body: FreeBody, shape: TriangleMesh, name: str, poses: np.ndarray) -> AffineBody:
    """A stiff body of even density that nothing holds, at ``poses`` [7] or [env, 7]."""
    return AffineBody(
        shape,
        density_kg_m3=body.mass_kg / mass_properties(shape, 1.0).volume_m3,
        name=name,
        friction_coefficient=body.friction,
        initial_pose=poses,
    )


def solid(shape: str, size_mm: Sequence[float]) -> TriangleMesh:
    """About its middle [m]: a "box" of three sides; a "cylinder", upright, of radius and height; a
    "sphere" of a radius."""
    size = [1e-3 * value for value in size_mm]
    if shape == "box":
        return box_mesh((size[0], size[1], size[2]))
    if shape == "cylinder":
        return cylinder_mesh(size[0], size[1])
    return sphere_mesh(size[0], size[0] / 5)
