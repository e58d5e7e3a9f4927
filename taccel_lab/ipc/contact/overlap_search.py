# SPDX-License-Identifier: Apache-2.0
"""Which environments start with bodies that overlap, found on the device.

Two closed surfaces overlap where an edge of one passes through a face of the other, or where one
lies inside the other as a whole, which the winding number of its faces about one node of each part
tells. Only bodies that may touch are looked at. ``intersection`` has the same rules in numpy and
says what is where; here an environment overlaps or does not.

A thread has an edge and goes through the faces of the other body, if that edge reaches into the box
around it: work is edges times faces in that box alone, and a new start among thousands of running
environments costs those microseconds.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.bodies.primitives import Ball
from taccel_lab.bodies.surface_parts import is_closed, one_node_of_each_part
from taccel_lab.ipc.broad_phase.boxes import find_body_boxes
from taccel_lab.ipc.contact.collision_lists import ball_inset
from taccel_lab.ipc.device.launches import launch
from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_total
from taccel_lab.ipc.distance.closest_pairs import point_triangle_distance_sq
from taccel_lab.model import BodyKind, Model
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

_ROUNDING = wp.constant(wp.float64(64.0 * np.finfo(np.float64).eps))


@wp.struct
class Surfaces:
    """What the search knows of the bodies.

    edges, faces: nodes of each; body_faces: range of each body's faces, [body_count]; node_bodies:
    body of each node; present: 1 where a body is, [env_count, body_count]; lower, upper: corners of
    a box around each body where it is [m], [env_count, body_count].
    """

    edges: wp.array(dtype=wp.vec2i)
    faces: wp.array(dtype=wp.vec3i)
    body_faces: wp.array(dtype=wp.vec2i)
    node_bodies: wp.array(dtype=wp.int32)
    present: wp.array2d(dtype=wp.int32)
    lower: wp.array2d(dtype=wp.vec3d)
    upper: wp.array2d(dtype=wp.vec3d)


@wp.func
def are_present(env: int, first: int, second: int, bodies: Surfaces) -> bool:
    """Whether two bodies are in an environment."""
    return bodies.present[env, first] != 0 and bodies.present[env, second] != 0


@wp.func
def _clean(volume: wp.float64, noise: wp.float64) -> wp.float64:
    """Zero where rounding may have made it."""
    if wp.abs(volume) <= noise:
        return wp.float64(0.0)
    return volume


@wp.func
def segment_pierces(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> bool:
    """Whether the segment p q passes through or touches the triangle a b c, by the signs of tet
    volumes; see ``bodies.crossings``."""
    largest = wp.max(
        wp.max(wp.max(wp.abs(p)), wp.max(wp.abs(q))),
        wp.max(wp.max(wp.abs(a)), wp.max(wp.max(wp.abs(b)), wp.max(wp.abs(c)))),
    )
    q = q - p
    a = a - p
    b = b - p
    c = c - p
    reach = wp.max(
        wp.max(wp.abs(q)), wp.max(wp.max(wp.abs(a)), wp.max(wp.max(wp.abs(b)), wp.max(wp.abs(c))))
    )
    noise = _ROUNDING * largest * reach * reach
    zero = wp.float64(0.0)
    normal = wp.cross(b - a, c - a)
    above = _clean(wp.dot(normal, -a), noise)
    below = _clean(wp.dot(normal, q - a), noise)
    if above * below > zero or (above == zero and below == zero):
        return False
    first = _clean(wp.dot(wp.cross(q, a), b), noise)
    second = _clean(wp.dot(wp.cross(q, b), c), noise)
    third = _clean(wp.dot(wp.cross(q, c), a), noise)
    lowest = wp.min(first, wp.min(second, third))
    highest = wp.max(first, wp.max(second, third))
    return lowest >= zero or highest <= zero


@wp.func
def half_solid_angle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.float64:
    """Half of the solid angle of a triangle seen from p [van Oosterom and Strackee 1983, eq. 8]."""
    a = a - p
    b = b - p
    c = c - p
    x = wp.length(a)
    y = wp.length(b)
    z = wp.length(c)
    down = x * y * z + wp.dot(a, b) * z + wp.dot(b, c) * x + wp.dot(c, a) * y
    return wp.atan2(wp.dot(a, wp.cross(b, c)), down)


@wp.kernel
def _begin_overlaps_kernel(
    mask: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    searched: wp.array(dtype=wp.int32),
):
    """Environments that are not finite are left to the step, which says so."""
    env, node = wp.tid()
    if mask[env] == 0 or not wp.isfinite(positions[env, node]):
        searched[env] = 0


@wp.kernel
def _crossing_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    found: wp.array(dtype=wp.int32),
):
    """An edge against all faces of another body, or of its own."""
    env, i = wp.tid()
    if searched[env] == 0 or found[env] != 0:
        return
    edge = bodies.edges[jobs[i][0]]
    other = jobs[i][1]
    own = bodies.node_bodies[edge[0]]
    if not are_present(env, own, other, bodies):
        return
    p = positions[env, edge[0]]
    q = positions[env, edge[1]]
    low = wp.min(p, q)
    high = wp.max(p, q)
    zero = wp.float64(0.0)
    if wp.max(wp.max(low - bodies.upper[env, other], bodies.lower[env, other] - high)) > zero:
        return
    for face in range(bodies.body_faces[other][0], bodies.body_faces[other][1]):
        nodes = bodies.faces[face]
        shared = own == other and (
            nodes[0] == edge[0]
            or nodes[1] == edge[0]
            or nodes[2] == edge[0]
            or nodes[0] == edge[1]
            or nodes[1] == edge[1]
            or nodes[2] == edge[1]
        )
        a = positions[env, nodes[0]]
        b = positions[env, nodes[1]]
        c = positions[env, nodes[2]]
        apart = wp.max(wp.max(wp.min(a, wp.min(b, c)) - high, low - wp.max(a, wp.max(b, c))))
        if not shared and apart <= zero:
            if segment_pierces(p, q, a, b, c):
                found[env] = 1
                return


@wp.kernel
def _inside_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    found: wp.array(dtype=wp.int32),
):
    """One node of a part of a surface against all of another surface, by a thread block."""
    env, i, lane = wp.tid()
    node = jobs[i][0]
    other = jobs[i][1]
    if searched[env] == 0 or not are_present(env, bodies.node_bodies[node], other, bodies):
        return
    p = positions[env, node]
    if wp.max(wp.max(p - bodies.upper[env, other], bodies.lower[env, other] - p)) > wp.float64(0.0):
        return
    half = wp.float64(0.0)
    for face in range(
        bodies.body_faces[other][0] + lane, bodies.body_faces[other][1], wp.block_dim()
    ):
        nodes = bodies.faces[face]
        a = positions[env, nodes[0]]
        b = positions[env, nodes[1]]
        c = positions[env, nodes[2]]
        half += half_solid_angle(p, a, b, c)
    total = block_total(half)
    # Once around is two pi of the half angles.
    if lane == 0 and wp.abs(total) > wp.float64(wp.pi):
        found[env] = 1


@wp.kernel
def _ball_overlaps_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    face_reaches_sq: wp.array2d(dtype=wp.float64),
    radii: wp.array(dtype=wp.float64),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    found: wp.array(dtype=wp.int32),
):
    """A ball against a face: curved faces may reach in by their inset, nodes may not."""
    env, i = wp.tid()
    ball = jobs[i][0]
    face = jobs[i][1]
    nodes = bodies.faces[face]
    if searched[env] == 0 or found[env] != 0:
        return
    if not are_present(env, bodies.node_bodies[ball], bodies.node_bodies[nodes[0]], bodies):
        return
    centre = positions[env, ball]
    radius = radii[i]
    a = positions[env, nodes[0]]
    b = positions[env, nodes[1]]
    c = positions[env, nodes[2]]
    nearest = wp.min(
        wp.length_sq(a - centre), wp.min(wp.length_sq(b - centre), wp.length_sq(c - centre))
    )
    kept = radius - ball_inset(radius, face_reaches_sq[env % face_reaches_sq.shape[0], face])
    if nearest <= radius * radius or point_triangle_distance_sq(centre, a, b, c) <= kept * kept:
        found[env] = 1


@wp.kernel
def _plane_kernel(
    searched: wp.array(dtype=wp.int32),
    jobs: wp.array(dtype=wp.vec2i),
    plane_normals: wp.array(dtype=wp.vec3d),
    bodies: Surfaces,
    positions: wp.array2d(dtype=wp.vec3d),
    found: wp.array(dtype=wp.int32),
):
    """A node below a plane or on it."""
    env, i = wp.tid()
    node = jobs[i][0]
    plane = jobs[i][1]
    if searched[env] == 0:
        return
    if not are_present(env, bodies.node_bodies[node], bodies.node_bodies[plane], bodies):
        return
    height = wp.dot(positions[env, node] - positions[env, plane], plane_normals[plane])
    if not (height > wp.float64(0.0)):
        found[env] = 1


class OverlapSearch:
    """Overlaps of the bodies of a model that may touch."""

    def __init__(self, model: Model) -> None:
        self._model = model
        device = model.device
        faces = model.surface.faces.numpy().reshape(-1, 3)
        none = np.zeros((0, 2), dtype=np.int64)
        crossing, inside = [none], [none]
        balls = set(model.contact_plan.ball_face.numpy().reshape(-1, 2)[:, 0].tolist())
        for first, second in model.contact_plan.pairs:
            a, b = model.bodies[first], model.bodies[second]
            if b.kind is BodyKind.PLANE:
                continue
            if b.nodes[0] in balls:
                inside.append(np.array([[b.nodes[0], first]]))
                continue
            # An edge of either may pass through a face of the other; of a body with itself, once.
            for edged, other in dict.fromkeys([(a, second), (b, first)]):
                edges = np.arange(*edged.edges)
                crossing.append(np.column_stack([edges, np.full(len(edges), other)]))
            for inner, outer in ((a, second), (b, first)) if first != second else ():
                if is_closed(faces[slice(*model.bodies[outer].faces)]):
                    nodes = one_node_of_each_part(faces[slice(*inner.faces)])
                    inside.append(np.column_stack([nodes, np.full(len(nodes), outer)]))

        def put(jobs: list[np.ndarray]) -> wp.array:
            return wp.array(np.concatenate(jobs).astype(np.int32), dtype=wp.vec2i, device=device)

        self._crossing, self._inside = put(crossing), put(inside)
        self._radii = wp.array(self._ball_radii(), dtype=wp.float64, device=device)
        self._body_nodes = wp.array([b.nodes for b in model.bodies], dtype=wp.vec2i, device=device)
        shape = (model.env_count, len(model.bodies))
        self._bodies = Surfaces()
        self._bodies.edges, self._bodies.faces = model.surface.edges, model.surface.faces
        ranges = [body.faces for body in model.bodies]
        self._bodies.body_faces = wp.array(ranges, dtype=wp.vec2i, device=device)
        self._bodies.node_bodies = model.surface.node_bodies
        self._bodies.present = model.present
        self._bodies.lower = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self._bodies.upper = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self._searched = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._found = wp.zeros(model.env_count, dtype=wp.int32, device=device)

    def _ball_radii(self) -> np.ndarray:
        """Radius without thickness of the ball of each job [m]."""
        model = self._model
        shapes = [getattr(body, "shape", None) for body in model.scene.bodies]
        radii = np.array([s.radius_m if isinstance(s, Ball) else 0.0 for s in shapes])
        nodes = model.contact_plan.ball_face.numpy().reshape(-1, 2)[:, 0]
        return radii[model.surface.node_bodies.numpy()[nodes]]

    def find(self, state: State, mask: wp.array) -> wp.array:
        """Whether bodies overlap in the environments of ``mask``, both int32, [env_count].

        Environments whose positions are not finite are none of them.
        """
        model, surface, plan = self._model, self._model.surface, self._model.contact_plan
        x = state.positions
        self._found.zero_()
        wp.copy(self._searched, mask)
        self._launch(_begin_overlaps_kernel, x.shape[1], [mask, x], self._searched)
        bodies = self._bodies
        find_body_boxes(self._searched, self._body_nodes, x, None, bodies.lower, bodies.upper)
        rest = [bodies, x]
        inputs = [self._searched, self._crossing, *rest]
        self._launch(_crossing_kernel, len(self._crossing), inputs, self._found)
        if len(self._inside):
            wp.launch_tiled(
                _inside_kernel,
                dim=[model.env_count, len(self._inside)],
                inputs=[self._searched, self._inside, *rest],
                outputs=[self._found],
                block_dim=BLOCK_THREADS,
                device=model.device,
            )
        inputs = [self._searched, plan.ball_face, surface.face_reaches_sq, self._radii, *rest]
        self._launch(_ball_overlaps_kernel, len(plan.ball_face), inputs, self._found)
        inputs = [self._searched, plan.node_plane, surface.plane_normals, *rest]
        self._launch(_plane_kernel, len(plan.node_plane), inputs, self._found)
        return self._found

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list, output: wp.array) -> None:
        """One thread an environment and job."""
        if count:
            launch(
                kernel,
                dim=(self._model.env_count, count),
                inputs=inputs,
                outputs=[output],
                device=self._model.device,
            )
