# SPDX-License-Identifier: Apache-2.0
"""A frictionless rigid ball pressed into a half-space, against Hertz.

    a = sqrt(R d),  F = 4/3 E* sqrt(R) d^1.5,  E* = E / (1 - nu^2),  p(r) = p0 sqrt(1 - r^2 / a^2)

for a rigid sphere of radius R at depth d [Johnson 1985, Contact Mechanics, section 4.2]. Mesh,
dhat and the size of the block are varied one at a time. Run from the repository root:

    python -m tests.verification.hertz_press --out benchmarks/results
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import Region
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.verification.half_space_mesh import half_space_mesh


@dataclass(frozen=True)
class HertzCase:
    """One press; a / R is 0.05, so that Hertz's parabola and his small strains hold."""

    cells: int = 6
    """Elements side by side from the axis to the contact radius."""
    element: Element = Element.LINEAR
    dhat_over_depth: float = 0.002
    domain_over_radius: float = 300.0
    """Radius of the block over the contact radius; its outside is fixed."""
    poisson_ratio: float = 0.3
    ball_radius_m: float = 1e-2
    depth_m: float = 2.5e-5
    young_pa: float = 1e5

    @property
    def contact_radius_m(self) -> float:
        """Hertz's contact radius [m]."""
        return float(np.sqrt(self.ball_radius_m * self.depth_m))

    @property
    def force_n(self) -> float:
        """Hertz's force [N]."""
        plane_modulus = self.young_pa / (1 - self.poisson_ratio**2)
        return 4 / 3 * plane_modulus * float(np.sqrt(self.ball_radius_m)) * self.depth_m**1.5

    @property
    def growth(self) -> float:
        """Ratio of neighbouring shells: about as long as wide, and finer with ``cells``.

        Quadratic tets follow the field far away in larger steps.
        """
        step = 1.2 if self.element is Element.QUADRATIC else 0.8
        return float(np.exp(step / self.cells))


@dataclass(frozen=True)
class HertzResult:
    """What a press gave, against Hertz."""

    force_n: float
    force_error: float
    """Force over Hertz's, less 1."""
    radius_m: float
    """Contact radius [m] from the second moment of the contact forces: sum f r^2 = 2/5 a^2 F."""
    outermost_m: float
    """Distance of the outermost node that carries force from the axis [m]."""
    element_m: float
    """Longest edge of a surface face in the contact [m]."""
    node_count: int
    residual_n: float
    radii_m: np.ndarray
    """Distance of the loaded nodes from the axis [m]."""
    pressures_pa: np.ndarray
    """Contact force over area of the loaded nodes [Pa]."""


def press(case: HertzCase) -> HertzResult:
    """Press the ball to its depth in one step."""
    mesh = half_space_mesh(
        case.contact_radius_m,
        case.cells,
        case.domain_over_radius * case.contact_radius_m,
        case.growth,
    )
    body = SoftBody(mesh, Material(case.young_pa, case.poisson_ratio), element=case.element)
    scene = Scene(body, (KinematicBody(Ball(case.ball_radius_m)),))
    model = scene.finalize()
    dhat = case.dhat_over_depth * case.depth_m
    solver = SolverIPC(model, SolverConfig(dhat_m=dhat, absolute_tolerance_n=1e-12))

    def pose(gap_m: float) -> np.ndarray:
        return np.array([[[0.0, 0.0, case.ball_radius_m + gap_m, 0.0, 0.0, 0.0, 1.0]]])

    state = initial_state(model, pose(2 * dhat))
    report = solver.step(state, pose(-case.depth_m))
    if not report.converged.all():
        raise RuntimeError(f"the press did not converge: {report.summary()}")

    force = -solver.contact_gradient.numpy()[0, : model.soft_count]
    positions = state.positions.numpy()[0, : model.soft_count]
    size = np.linalg.norm(force, axis=1)
    loaded = np.flatnonzero(size > 1e-3 * size.max())
    radii = np.hypot(positions[:, 0], positions[:, 1])
    top = body.nodal_mesh.region_faces(Region.CONTACT)
    corners = positions[top[np.isin(top, loaded).any(axis=1)]]
    area = model.surface.node_areas.numpy()[0, : model.soft_count]
    total = -float(force[:, 2].sum())
    return HertzResult(
        force_n=total,
        force_error=total / case.force_n - 1,
        radius_m=float(np.sqrt(2.5 * (size * radii**2).sum() / size.sum())),
        outermost_m=float(radii[loaded].max()),
        element_m=float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()),
        node_count=model.soft_count,
        residual_n=float(report.residual_n[0]),
        radii_m=radii[loaded],
        pressures_pa=size[loaded] / area[loaded],
    )
