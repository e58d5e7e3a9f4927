# SPDX-License-Identifier: Apache-2.0
"""Ways of kinematic bodies that lead through what is held: no step goes there, however short.

Both are prescribed, a body by its target and the bonded nodes of a gel by what they are bonded to,
so that where their surfaces cross nothing can give way. Such a step squeezes the gel until its
contacts are as stiff as numbers go. Surfaces are looked at in poses along the way, near enough to
each other that no body jumps over a face; a sheet thinner than ``_LEAST_PART`` of its size might.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import KinematicBody
from taccel_lab.bodies.crossings import crossing_pairs, point_triangle_distances
from taccel_lab.bodies.mass_properties import winding_number
from taccel_lab.bodies.primitives import Ball, TriangleMesh, unique_edges
from taccel_lab.bodies.surface_topology import is_closed
from taccel_lab.model import Model
from taccel_lab.model.embedding import rotate
from taccel_lab.model.kinematics import interpolate_poses
from taccel_lab.state import State

_LEAST_PART = 0.02
"""Smallest extent of a body over its largest by which poses along its way are spaced."""
_BACK = np.array([-1.0, -1.0, -1.0, 1.0])
_DEEP = 0.99
"""Part of a ball's radius within which a face is in its way: facets reach a little into balls."""


@dataclass(frozen=True)
class BlockedWay:
    """A body that is to go through what is held."""

    body: str
    """Name of the body."""
    gel: str
    """Name of what is held."""
    way_m: float
    """How far its surface was to go in the step."""
    free_m: float
    """How much of that, at most, lies before."""
    thickness_m: float
    """Smallest extent of the gel at rest."""
    point_m: np.ndarray
    """One place where they cross, in the frame of what holds the gel, [3]."""

    def place(self) -> str:
        """What would happen, and where."""
        x, y, z = 1e3 * self.point_m
        return (
            f"{self.body!r} would pass through {self.gel!r}, {1e3 * self.thickness_m:.3g} mm "
            f"thick, where that is held, near x {x:.3f}, y {y:.3f}, z {z:.3f} mm: nothing gives "
            "way there"
        )

    def words(self) -> str:
        """What is wrong with a step and what to do, in two sentences."""
        return (
            f"a step of {1e3 * self.way_m:.4g} mm cannot be taken: after {1e3 * self.free_m:.3g} "
            f"mm {self.place()}. End it before that, or, where a speed sets the target, take a "
            "shorter dt or more steps"
        )


@dataclass(frozen=True)
class _Tool:
    """A kinematic body that may touch a gel."""

    body: int
    frame: int
    shape: Ball | TriangleMesh
    vertices: np.ndarray
    """Vertices in its own frame [m], [n, 3]; of a ball its centre."""
    faces: np.ndarray
    edges: np.ndarray
    closed: bool
    box: np.ndarray
    """Corners of the box around its vertices, [8, 3]."""
    around_m: float
    """Radius of a ball, else 0."""
    reach_m: float
    """Largest distance of its surface from its origin."""
    least_m: float
    """Smallest extent, or what counts as such."""


@dataclass(frozen=True)
class _Held:
    """The faces of a gel whose nodes are all bonded, and what may run into them."""

    gel: int
    mount: int
    """Kinematic index of what carries it, -1 for the world."""
    corners: np.ndarray
    """Corners of the faces in that frame [m], [rest_count or env_count, face, 3, 3]."""
    low: np.ndarray
    """Lower corner of the box around all of them, [3]."""
    high: np.ndarray
    thickness_m: float
    tools: list[_Tool]


class BlockedWays:
    """Finds them for a model; without gels that are held and bodies that may touch these there is
    nothing to find."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._held = _held_faces(model)

    def __bool__(self) -> bool:
        return bool(self._held)

    def of_step(
        self, state: State, end_poses: wp.array, failed: np.ndarray
    ) -> dict[int, BlockedWay]:
        """Find the ways of a step from a state to its targets, in the environments where it has
        ``failed`` (bool, [env_count]): no other pays for it."""
        if not (failed.any() and self):
            return {}
        shape = (self._model.env_count, -1, 7)
        start, end = (poses.numpy().reshape(shape) for poses in (state.poses, end_poses))
        return self.find(start, end, failed)

    def find(self, start: np.ndarray, end: np.ndarray, who: np.ndarray) -> dict[int, BlockedWay]:
        """Ways from ``start`` to ``end`` (poses, [env_count, kinematic_count, 7]) that are blocked,
        by environment; only those of ``who``, bool, [env_count]."""
        found: dict[int, BlockedWay] = {}
        for held in self._held:
            for tool in held.tools:
                first, last = (_within(poses, tool.frame, held.mount) for poses in (start, end))
                for env in map(int, _comes_near(held, tool, first, last)):
                    present = self._model.present.numpy()[env, [held.gel, tool.body]].all()
                    if who[env] and present and env not in found:
                        way = self._look(held, tool, env, first[env], last[env])
                        if way is not None:
                            found[env] = way
        return found

    def _look(
        self, held: _Held, tool: _Tool, env: int, first: np.ndarray, last: np.ndarray
    ) -> BlockedWay | None:
        moved = np.linalg.norm(
            _placed(last, tool.vertices) - _placed(first, tool.vertices), axis=1
        ).max()
        if not moved > 0:
            return None
        count = math.ceil(2 * moved / tool.least_m)
        parts = np.arange(1, count + 1) / count
        ways = np.broadcast_to(np.stack([first, last])[:, None, None], (2, count, 1, 7))
        corners = held.corners[env % len(held.corners)]
        for part, pose in zip(parts, interpolate_poses(ways[0], ways[1], parts)[:, 0], strict=True):
            point = _crossing(tool, _placed(pose, tool.vertices), corners)
            if point is not None:
                return BlockedWay(
                    body=self._model.bodies[tool.body].name,
                    gel=self._model.bodies[held.gel].name,
                    way_m=float(moved),
                    free_m=part * float(moved),
                    thickness_m=held.thickness_m,
                    point_m=point,
                )
        return None


def _held_faces(model: Model) -> list[_Held]:
    scene, found = model.scene, []
    first = len(model.bodies) - len(scene.planes) - len(scene.kinematic_bodies)
    free = model.free_index.numpy()
    frames = np.full(model.node_count, -1)
    frames[model.frame_nodes.numpy()] = model.frame_ids.numpy()
    embedded = model.parents.numpy() >= 0
    rest = model.rest_positions.numpy()
    for gel, body in enumerate(scene.soft_bodies):
        start = model.bodies[gel].nodes[0]
        faces = start + body.nodal_mesh.faces.astype(np.int64)
        faces = faces[(free[faces] < 0).all(axis=1) & ~embedded[faces].any(axis=1)]
        tools = []
        for i, j in model.contact_plan.pairs:
            other = scene.bodies[j]
            if i == gel and isinstance(other, KinematicBody) and other.shape is not None:
                tools.append(_tool(other.shape, j, j - first))
        if len(faces) and tools:
            own = rest[:, model.bodies[gel].node_slice]
            thickness = float(np.ptp(own, axis=1).min())
            corners = rest[:, faces]
            if body.initial_pose is not None:
                pose = body.initial_pose.reshape(-1, 1, 1, 7)
                corners = rotate(pose[..., 3:], corners) + pose[..., :3]
            low, high = corners.min(axis=(0, 1, 2)), corners.max(axis=(0, 1, 2))
            mount = int(frames[faces[0, 0]])
            found.append(_Held(gel, mount, corners, low, high, thickness, tools))
    return found


def _tool(shape: Ball | TriangleMesh, body: int, frame: int) -> _Tool:
    around, vertices, faces = 0.0, np.zeros((1, 3)), np.zeros((0, 3), dtype=np.int64)
    if isinstance(shape, Ball):
        around = shape.radius_m
    else:
        vertices, faces = shape.vertices_m, shape.faces
    box = np.array(list(product(*np.stack([vertices.min(axis=0), vertices.max(axis=0)], axis=1))))
    extent = np.ptp(box, axis=0) + around
    return _Tool(
        body=body,
        frame=frame,
        shape=shape,
        vertices=vertices,
        faces=faces,
        edges=unique_edges(faces),
        closed=is_closed(faces),
        box=box,
        around_m=around,
        reach_m=float(np.linalg.norm(box, axis=1).max()) + around,
        least_m=max(float(extent.min()), _LEAST_PART * float(extent.max())),
    )


def _within(poses: np.ndarray, frame: int, mount: int) -> np.ndarray:
    """mount_from_body of all environments, [env_count, 7]."""
    body = poses[:, frame]
    if mount < 0:
        return body
    back = poses[:, mount, 3:] * _BACK
    turned = body[:, 3:]
    result = np.empty_like(body)
    result[:, :3] = rotate(back, body[:, :3] - poses[:, mount, :3])
    result[:, 3:6] = (
        back[:, 3:] * turned[:, :3]
        + turned[:, 3:] * back[:, :3]
        + np.cross(back[:, :3], turned[:, :3])
    )
    result[:, 6] = back[:, 3] * turned[:, 3] - (back[:, :3] * turned[:, :3]).sum(axis=1)
    return result


def _comes_near(held: _Held, tool: _Tool, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Environments in which the box around a body, on its way between poses [env_count, 7], comes
    to the box around a held face."""
    origins = first[:, :3], last[:, :3]
    low, high = np.minimum(*origins) - tool.reach_m, np.maximum(*origins) + tool.reach_m
    near = np.flatnonzero(((low <= held.high) & (high >= held.low)).all(axis=1))
    if len(near) == 0:
        return near
    ends = [rotate(pose[near, None, 3:], tool.box) + pose[near, None, :3] for pose in (first, last)]
    points = np.concatenate(ends, axis=1)
    # Arcs leave their chords by up to r (1 - cos(angle / 2)).
    half = np.abs((first[near, 3:] * last[near, 3:]).sum(axis=1))
    off = (tool.around_m + tool.reach_m * np.maximum(1 - half, 0.0))[:, None]
    low, high = points.min(axis=1) - off, points.max(axis=1) + off
    boxes = ((low <= held.high) & (high >= held.low)).all(axis=1)
    near, low, high = near[boxes], low[boxes], high[boxes]
    corners = held.corners if len(held.corners) == 1 else held.corners[near % len(held.corners)]
    lowest, highest = corners.min(axis=2), corners.max(axis=2)
    touched = ((lowest <= high[:, None]) & (highest >= low[:, None])).all(axis=2).any(axis=1)
    return near[touched]


def _placed(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    return rotate(pose[3:], points) + pose[:3]


def _crossing(tool: _Tool, vertices: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
    """A place where a body with these vertices crosses faces [n, 3, 3], or has them inside."""
    low, high = vertices.min(axis=0) - tool.around_m, vertices.max(axis=0) + tool.around_m
    inside = (corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)
    near = corners[inside.all(axis=1)]
    if len(near) == 0:
        return None
    if isinstance(tool.shape, Ball):
        distance = point_triangle_distances(vertices[0], near)
        deepest = int(np.argmin(distance))
        return near[deepest].mean(axis=0) if distance[deepest] < _DEEP * tool.around_m else None
    sides = near[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
    triangles = vertices[tool.faces]
    for segments, faces in ((vertices[tool.edges], near), (sides, triangles)):
        edge, _ = crossing_pairs(segments, faces)
        if len(edge):
            return segments[edge[0]].mean(axis=0)
    point = near[0, 0]
    if tool.closed and abs(winding_number(point, triangles)) > 0.5:
        return point
    return None
