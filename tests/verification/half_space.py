# SPDX-License-Identifier: Apache-2.0
"""A rigid body on an elastic half-space, which the contact tests share.

The block is fixed on a half sphere 300 contact radii away. Far from the contact the half-space of
the closed forms moves there by F (1 - nu^2) / (pi E r); holding it still instead adds about
2 / (300 pi), 0.2 % of the depth, so that no correction is made.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, TriangleMesh
from taccel_lab.solvers import SolverConfig, SolverIPC, StepReport
from taccel_lab.state import initial_state
from tests.support.blocks import everywhere, pose

DOMAIN_OVER_RADIUS = 300.0
GROWTH = 2.0
"""Ratio of neighbouring shells of the block."""


class HalfSpace:
    """A block with a rigid body above it, moved without being turned; quasi-static."""

    def __init__(
        self,
        mesh: TetMesh,
        shape: TriangleMesh | Ball,
        *,
        young_pa: float,
        poisson: float,
        config: SolverConfig,
        start_m: float,
        friction: float = 0.0,
        element: Element = Element.QUADRATIC,
    ) -> None:
        """``start_m``: height of the body's origin at first [m]."""
        soft = SoftBody(mesh, Material(young_pa, poisson), element=element)
        self.model = Scene(soft, KinematicBody(shape, friction)).finalize()
        self.solver = SolverIPC(self.model, config)
        self.state = initial_state(self.model, everywhere(1, pose(0, 0, start_m)))

    def move(self, x_m: float, z_m: float) -> StepReport:
        """Bring the body's origin to (x, 0, z) in one step."""
        report = self.solver.step(self.state, everywhere(1, pose(x_m, 0, z_m)))
        assert report.converged.all(), report.summary()
        return report

    @property
    def positions_m(self) -> np.ndarray:
        """Of the nodes of the block, shape [node, 3]."""
        return self.state.positions.numpy()[0, : self.model.soft_count]

    @property
    def rest_m(self) -> np.ndarray:
        """Of the nodes of the block, shape [node, 3]."""
        return self.model.rest_positions.numpy()[0, : self.model.soft_count]

    @property
    def areas_m2(self) -> np.ndarray:
        """Part of the surface that each node stands for at rest, shape [node]."""
        return self.model.surface.node_areas.numpy()[0, : self.model.soft_count]

    @property
    def normal_n(self) -> np.ndarray:
        """Contact force on each node of the block, shape [node, 3]."""
        return -self.solver.contact_gradient.numpy()[0, : self.model.soft_count]

    @property
    def friction_n(self) -> np.ndarray:
        """Friction force on each node of the block, shape [node, 3]."""
        return -self.solver.friction_gradient.numpy()[0, : self.model.soft_count]
