# SPDX-License-Identifier: Apache-2.0
"""Where the nodes of each body of a scene are, what they weigh, and what they follow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.bodies.bodies import SoftBody
from taccel_lab.bodies.mass_properties import MassProperties
from taccel_lab.bodies.primitives import Ball, TriangleMesh
from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model.elastic import SoftDiscretization, discretize
from taccel_lab.model.embedding import rotate
from taccel_lab.model.model import BodyKind


@dataclass(frozen=True)
class LayoutPart:
    """One body of the scene, in its own node numbers."""

    kind: BodyKind
    rest_m: np.ndarray
    """Shape [rest_count, node_count, 3]."""
    faces: np.ndarray


class Layout:
    """Where the nodes of each body are."""

    def __init__(self, scene: SceneDescription) -> None:
        self.scene = scene
        self.soft: list[SoftDiscretization] = [discretize(body) for body in scene.soft_bodies]
        self.carriers = scene.carriers
        """Affine body that each soft body is mounted on, -1 for none."""
        self.rest_count = max([len(part.rest_m) for part in self.soft], default=1)
        parts = [
            LayoutPart(BodyKind.SOFT, _in_mount(body, part.rest_m), part.faces)
            for body, part in zip(scene.soft_bodies, self.soft, strict=True)
        ]
        self.properties = [
            self._with_reach(body.mass_properties(), [parts[i] for i in self.carried_by(index)])
            for index, body in enumerate(scene.affine_bodies)
        ]
        for body in scene.affine_bodies:
            parts.append(LayoutPart(BodyKind.AFFINE, body.shape.vertices_m[None], body.shape.faces))
        for body in scene.kinematic_bodies:
            vertices, faces = _vertices_and_faces(body.shape)
            parts.append(LayoutPart(BodyKind.KINEMATIC, vertices[None], faces))
        for plane in scene.planes:
            origin = np.asarray(plane.point_m, dtype=np.float64)[None, None]
            parts.append(LayoutPart(BodyKind.PLANE, origin, np.zeros((0, 3), dtype=np.int32)))
        self.parts = parts
        self.affine_count = len(self.properties)
        self.soft_count = sum(part.rest_m.shape[1] for part in self.soft)
        node = 0
        self.starts: list[int] = []
        for index, part in enumerate(parts):
            if index == len(self.soft):
                node += 4 * self.affine_count
            self.starts.append(node)
            node += part.rest_m.shape[1]
        self.node_count = node
        self.first_control = self.soft_count

    def carried_by(self, affine: int) -> list[int]:
        """Soft bodies that are mounted on an affine body."""
        return [i for i, carrier in enumerate(self.carriers) if carrier == affine]

    @staticmethod
    def _with_reach(solid: MassProperties, gels: list[LayoutPart]) -> MassProperties:
        """A solid whose radius takes in the gels on it."""
        reach = [np.linalg.norm(gel.rest_m - solid.center_m, axis=-1).max() for gel in gels]
        return replace(solid, radius_m=max([solid.radius_m, *map(float, reach)]))

    def node_range(self, body: int) -> tuple[int, int]:
        start = self.starts[body]
        return start, start + self.parts[body].rest_m.shape[1]

    def control_nodes(self) -> np.ndarray:
        """Control nodes of each affine body, shape [affine_count, 4]."""
        return self.first_control + np.arange(4 * self.affine_count).reshape(-1, 4)

    def rest_positions(self) -> np.ndarray:
        """All nodes at rest [m], shape [rest_count, node_count, 3]."""
        rest = np.zeros((self.rest_count, self.node_count, 3))
        for body, part in enumerate(self.parts):
            first, last = self.node_range(body)
            rest[:, first:last] = part.rest_m
        for nodes, solid in zip(self.control_nodes(), self.properties, strict=True):
            rest[:, nodes[0]] = solid.center_m
            rest[:, nodes[1:]] = solid.radius_m * solid.axes.T
        return rest

    def free_nodes(self) -> np.ndarray:
        """Nodes with a row in the Newton system, ascending."""
        free = np.zeros(self.node_count, dtype=bool)
        for body, part in enumerate(self.soft):
            first, last = self.node_range(body)
            free[first:last] = True
            free[first + part.bonded] = False
        free[self.control_nodes().ravel()] = True
        return np.flatnonzero(free).astype(np.int32)

    def masses(self) -> np.ndarray:
        """Lumped masses [kg], shape [rest_count, node_count]."""
        masses = np.zeros((self.rest_count, self.node_count))
        for body, part in enumerate(self.soft):
            first, last = self.node_range(body)
            masses[:, first:last] = part.masses_kg
        for nodes, solid in zip(self.control_nodes(), self.properties, strict=True):
            masses[:, nodes[0]] = solid.mass_kg
            masses[:, nodes[1:]] = solid.second_moments_kg_m2 / solid.radius_m**2
        return masses

    def embedding(self) -> tuple[np.ndarray, np.ndarray]:
        """First control node of embedded vertices [node_count], and weights [node_count, 4]."""
        parents = np.full(self.node_count, -1, dtype=np.int32)
        weights = np.zeros((self.node_count, 4))
        for index, solid in enumerate(self.properties):
            body = len(self.soft) + index
            rows = slice(*self.node_range(body))
            parents[rows] = self.control_nodes()[index, 0]
            weights[rows, 0] = 1.0
            local = solid.to_principal(self.parts[body].rest_m[0])
            weights[rows, 1:] = local / solid.radius_m
            for gel in self.carried_by(index):
                mine = self.soft[gel].bonded
                at = self.starts[gel] + mine
                parents[at] = self.control_nodes()[index, 0]
                weights[at, 0] = 1.0
                local = solid.to_principal(self.parts[gel].rest_m[0, mine])
                weights[at, 1:] = local / solid.radius_m
        return parents, weights

    def carried_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Bonded nodes that affine bodies carry, and the first of each body and the end,
        [affine_count + 1]."""
        found: list[np.ndarray] = [np.zeros(0, dtype=np.int64)]
        starts = [0]
        for index in range(self.affine_count):
            found += [self.starts[i] + self.soft[i].bonded for i in self.carried_by(index)]
            starts.append(sum(map(len, found)))
        return np.concatenate(found), np.array(starts)

    def riders(self) -> np.ndarray:
        """Free nodes of gels on affine bodies and the index of the body, [n, 2]."""
        found = [np.zeros((0, 2), dtype=np.int64)]
        for gel, carrier in enumerate(self.carriers):
            if carrier >= 0:
                nodes = np.delete(np.arange(*self.node_range(gel)), self.soft[gel].bonded)
                found.append(np.column_stack([nodes, np.full(len(nodes), carrier)]))
        return np.concatenate(found)

    def frame_followers(self, at_start: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that follow a kinematic frame, and the kinematic index of each. ``at_start``: all
        that a frame places before the first step, whole gels that are mounted on it."""
        names = [body.name for body in self.scene.kinematic_bodies]
        nodes, frames = [], []
        for index in range(len(names)):
            body = len(self.soft) + self.affine_count + index
            nodes.append(np.arange(*self.node_range(body)))
            frames.append(np.full(len(nodes[-1]), index))
        for body, (soft, part) in enumerate(zip(self.scene.soft_bodies, self.soft, strict=True)):
            if soft.mount in names:
                mine = np.arange(*self.node_range(body))
                nodes.append(mine if at_start else mine[part.bonded])
                frames.append(np.full(len(nodes[-1]), names.index(soft.mount)))
        if not nodes:
            return np.zeros(0), np.zeros(0)
        return np.concatenate(nodes), np.concatenate(frames)

    def frame_radii(self) -> np.ndarray:
        """Reach of each kinematic body and of what it carries from its origin [m], shape
        [rest_count, kinematic_count]: a mounted gel may have another size in each environment."""
        nodes, frames = self.frame_followers()
        reach = np.linalg.norm(self.rest_positions()[:, nodes.astype(int)], axis=-1)
        radii = np.zeros((self.rest_count, len(self.scene.kinematic_bodies)))
        for index, body in enumerate(self.scene.kinematic_bodies):
            radii[:, index] = reach[:, frames == index].max(axis=1, initial=0.0)
            if isinstance(body.shape, Ball):
                radii[:, index] = np.maximum(radii[:, index], body.shape.radius_m)
        return radii


def _in_mount(body: SoftBody, rest_m: np.ndarray) -> np.ndarray:
    """Rest positions [m] in the frame of the mount."""
    if body.mount_pose is None:
        return rest_m
    return rotate(body.mount_pose[3:], rest_m) + body.mount_pose[:3]


def _vertices_and_faces(shape: TriangleMesh | Ball | None) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(shape, TriangleMesh):
        return shape.vertices_m, shape.faces
    count = 0 if shape is None else 1
    return np.zeros((count, 3)), np.zeros((0, 3), dtype=np.int32)
