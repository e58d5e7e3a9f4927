# SPDX-License-Identifier: Apache-2.0
"""Scenes of ours in newton's viewers: a newton model of the same bodies, whose state follows ours.

All viewers take models and states - file, USD, Rerun, Viser, OpenGL - so nothing is drawn here.
The model is for looks: soft bodies have the corners of their tets, materials are not stated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import AffineBody, KinematicBody, SoftBody
from taccel_lab.bodies.primitives import Ball, TriangleMesh
from taccel_lab.model import Model
from taccel_lab.newton_bridge.newton_model import newton_module, rigid_motion
from taccel_lab.state import State

FORCE_LENGTH = 0.01
"""Length of the line that a force of 1 N is drawn as [m]."""


class SceneView:
    """Shows states of a model in one of newton's viewers."""

    def __init__(self, viewer: Any, model: Model) -> None:
        """
        Args:
            viewer: Of ``newton.viewer``; the model is set there.
            model: Of a scene of ours, or ``SolverGel.gel_model``.

        Raises:
            InputError: Where newton is not installed.
        """
        self._viewer, self._model = viewer, model
        newton = newton_module()
        builder = newton.ModelBuilder()
        corners = []
        for body_id, body in enumerate(model.scene.bodies):
            if isinstance(body, SoftBody):
                first = model.bodies[body_id].node_slice.start
                corners.append(first + np.arange(body.mesh.node_count))
                builder.add_soft_mesh(
                    pos=wp.vec3(),
                    rot=wp.quat_identity(),
                    scale=1.0,
                    vel=wp.vec3(),
                    vertices=body.mesh.nodes_m.astype(np.float32),
                    indices=body.mesh.tets.ravel(),
                    density=1000.0,
                    add_surface_mesh_edges=False,
                    label=body.name,
                )
            elif isinstance(body, (AffineBody, KinematicBody)):
                still = isinstance(body, KinematicBody)
                row = builder.add_body(
                    mass=1.0, inertia=wp.mat33(np.eye(3)), label=body.name, is_kinematic=still
                )
                _add_shape(builder, row, body.shape)
            else:
                a, b, c = body.normal
                d = -float(np.dot(body.normal, body.point_m))
                builder.add_shape_plane((a, b, c, d), width=0.0, length=0.0, label=body.name)
        self.newton_model = builder.finalize(device=str(model.device))
        """The bodies as newton's model."""
        self.newton_state = self.newton_model.state()
        """Where they were shown last."""
        self._corners = np.concatenate([np.zeros(0, dtype=int), *corners])
        viewer.set_model(self.newton_model)

    def log(
        self, state: State, time_s: float, env: int = 0, forces: np.ndarray | None = None
    ) -> None:
        """Show a state as a separate frame.

        Args:
            state: Of the model.
            time_s: When it was.
            env: Which environment.
            forces: On nodes [N], [node, 3], drawn as lines of 1 cm a newton by viewers that draw:
                for instance ``outputs.normal_forces.numpy()[env]``.
        """
        self.follow(state, env)
        self._viewer.begin_frame(time_s)
        self._viewer.log_state(self.newton_state)
        if forces is not None:
            x = state.positions.numpy()[env]
            rows = np.flatnonzero(np.linalg.norm(forces, axis=1) > 0)
            ends = (x[rows], x[rows] + FORCE_LENGTH * forces[rows])
            self._viewer.log_lines("/forces", *map(self._points, ends), (0.8, 0.1, 0.1), width=1e-4)
        self._viewer.end_frame()

    def follow(self, state: State, env: int = 0) -> None:
        """Put ``newton_state`` where a state of ours is."""
        x, v = state.positions.numpy()[env], state.velocities.numpy()[env]
        target = self.newton_state
        if len(self._corners):
            target.particle_q.assign(x[self._corners].astype(np.float32))
            target.particle_qd.assign(v[self._corners].astype(np.float32))
        rows, rates = [], []
        for k, solid in enumerate(self._model.affine.properties):
            first = self._model.affine.first_control + 4 * k
            poses, spins = rigid_motion(
                x[None, first : first + 4], v[None, first : first + 4], solid
            )
            rows += list(poses)
            rates += list(spins)
        rows += list(state.poses.numpy()[env].reshape(-1, 7))
        if rows:
            rates += [np.zeros(6)] * (len(rows) - len(rates))
            target.body_q.assign(np.array(rows, dtype=np.float32))
            target.body_qd.assign(np.array(rates, dtype=np.float32))

    def _points(self, points: np.ndarray) -> wp.array:
        return wp.array(points.astype(np.float32), dtype=wp.vec3, device=self._model.device)


def _add_shape(builder: Any, row: int, shape: TriangleMesh | Ball | None) -> None:
    """The surface of a body, without mass; a frame has none."""
    newton = newton_module()
    config = newton.ModelBuilder.ShapeConfig(density=0.0)
    if isinstance(shape, Ball):
        builder.add_shape_sphere(row, radius=shape.radius_m, cfg=config)
    elif shape is not None:
        mesh = newton.Mesh(shape.vertices_m.astype(np.float32), shape.faces.ravel())
        builder.add_shape_mesh(row, mesh=mesh, cfg=config)
