# SPDX-License-Identifier: Apache-2.0
"""What every task's file says, and parts that several tasks have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh, labelled
from taccel_lab.reading.strict_model import Number, StrictModel, Whole
from taccel_lab.scene import AffineBody, Element, Material, SoftBody, TriangleMesh
from taccel_lab.solvers import SolverConfig

G = 9.81
"""Gravity [m/s^2], downwards."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Count = Annotated[Whole, Field(ge=1, le=100_000)]


class Published(StrictModel):
    """A figure that somebody published for a task like this one."""

    who: str
    figure: str
    source: str
    differs: str
    """What makes it not comparable."""


class TaskParameters(StrictModel):
    """What the file of any task says."""

    kind: str
    summary: str
    criterion: str
    """In words; the numbers are those of the file."""
    headline: str
    """The figure that pictures and tables show first."""
    seeds: Count
    """Seeds 0, 1, ... of a run that names no other number."""
    environments: Count
    """Seeds that one solver steps together."""
    dt_s: Positive
    steps: Count
    """Steps after which it is over."""
    published: Annotated[tuple[Published, ...], Field(min_length=1)]


class Pad(StrictModel):
    """A block of gel, bonded at its back."""

    cells: tuple[Count, Count, Count]
    size_mm: tuple[Positive, Positive, Positive]
    """Width and height of its face, and thickness."""
    young_modulus_pa: Positive
    poisson_ratio: Number
    density_kg_m3: Positive
    friction: NotNegative
    element: Element
    jitter: Annotated[Number, Field(ge=0, le=0.3)] = 0.0
    """How far nodes are moved, as a part of a cell: no direction of the mesh is special then."""
    focus: NotNegative = 0.0
    """Cells shrink towards the middle of the face, as sinh(focus s) does for s towards 0."""

    def mesh(self) -> TetMesh:
        """Its contact face at z = 0, the bond below."""
        width, height, thickness = (1e-3 * side for side in self.size_mm)
        if self.focus == 0:
            return block_mesh(self.cells, (width, height, thickness), self.jitter, seed=4)
        unit = block_mesh(self.cells, (2.0, 2.0, 1.0), self.jitter, seed=4)
        graded = np.sinh(self.focus * unit.nodes_m) / np.sinh(self.focus)
        return labelled(graded * [width / 2, height / 2, thickness], unit.tets)

    def soft_body(self, mesh: TetMesh, name: str = "gel", mount: str | None = None) -> SoftBody:
        """The gel, in its own frame, or in that of its mount."""
        material = Material(self.young_modulus_pa, self.poisson_ratio, self.density_kg_m3)
        return SoftBody(
            mesh,
            material,
            name=name,
            mount=mount,
            friction_coefficient=self.friction,
            element=Element(self.element),
        )


class Contact(StrictModel):
    """How close contact is solved."""

    dhat_mm: Positive
    friction_speed_mm_s: Positive
    """Sliding speed below which friction is static."""
    absolute_tolerance_n: Positive

    def config(self, quasi_static_s: float | None = None) -> SolverConfig:
        """Settings of the solver, of a scene with inertia, or of one without that takes steps of
        ``quasi_static_s``."""
        config = SolverConfig(
            dhat_m=1e-3 * self.dhat_mm, absolute_tolerance_n=self.absolute_tolerance_n
        )
        speed = 1e-3 * self.friction_speed_mm_s
        if quasi_static_s is None:
            return replace(config, friction_speed_m_s=speed)
        return replace(config, friction_eps_m=speed * quasi_static_s)


class FreeBody(StrictModel):
    """A stiff body that nothing holds."""

    mass_kg: Positive
    friction: NotNegative

    def body(self, shape: TriangleMesh, name: str, poses: np.ndarray) -> AffineBody:
        """It, of even density, at ``poses`` [env, 7]."""
        return AffineBody(
            shape,
            density_kg_m3=self.mass_kg / mass_properties(shape, 1.0).volume_m3,
            name=name,
            friction_coefficient=self.friction,
            initial_pose=poses,
        )


class PlanarStart(StrictModel):
    """Half ranges of where something is, from above the middle."""

    x_mm: NotNegative
    """Along the way on which fingers or gels close."""
    y_mm: NotNegative
    yaw_deg: NotNegative

    def draw(self, seeds: Sequence[int]) -> tuple[list[dict[str, float]], np.ndarray]:
        """What each seed draws, and the poses of that, [seed, 7], at z = 0."""
        ranges = {"x_mm": self.x_mm, "y_mm": self.y_mm, "yaw_deg": self.yaw_deg}
        starts = [draw(seed, ranges) for seed in seeds]
        yaw = np.radians([start["yaw_deg"] for start in starts])
        poses = np.zeros((len(starts), 7))
        poses[:, 0] = [1e-3 * start["x_mm"] for start in starts]
        poses[:, 1] = [1e-3 * start["y_mm"] for start in starts]
        poses[:, 5], poses[:, 6] = np.sin(yaw / 2), np.cos(yaw / 2)
        return starts, poses


def draw(seed: int, half_ranges: dict[str, float]) -> dict[str, float]:
    """Offsets of a seed, each evenly from minus to plus its half range, in the order given: the
    same whatever other seeds run beside it."""
    generator = np.random.default_rng(seed)
    return {name: float(generator.uniform(-half, half)) for name, half in half_ranges.items()}
