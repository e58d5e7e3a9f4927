# SPDX-License-Identifier: Apache-2.0
"""The collision set of each environment, and the roles of surfaces in it.

Roles say which surface of a pair measures the contact, how stiff its contact is, and how far a body
keeps from itself. The set has an area-weighted contact, and a guard around everything:

    contact    kappa sum_nodes A_i max_faces dhat g(d(x_i, f) / dhat)
    guard      the same with `guard` < dhat in place of dhat, for what the contact leaves out

The contact is the integral of a pressure kappa |g'(gap / dhat)| over *one* of two surfaces, with
the nodes as quadrature points: over the soft one of a soft and a stiff body, over the finer one of
two soft bodies. Two stiff bodies, and a body with itself, take the mean of both integrals, as in
the convergent potential of Li, Kaufman and Jiang (2023), from which the area weights and the
maximum over faces are. On one side, a flat face acts straight along its normal and with a uniform
pressure whatever the two triangulations are; the sum of both sides, and above all its edge-edge
terms, does neither. That alone would let the vertices and edges of the other surface through
between the nodes. Hence the guard: the other side's nodes against faces, and all pairs of edges
(mollified where nearly parallel [Li et al. 2020, sec. 4]). Every pair of primitives that approaches
zero distance thus has an infinite energy, but flat contacts, whose gap is above the guard's range
up to pressures of about two kappa, do not feel it.

The maximum over faces is their inclusion-exclusion sum (the paper's "improved max"): each face
counts +1, each edge between two faces -1, each inner vertex +1. Most of these terms are the same
function - the distance to one shared edge or vertex - and cancel, so they are merged: a feature
enters once with coefficient

    edge:   (faces whose closest feature it is) - 1
    vertex: (faces whose closest feature it is) - (edges whose closest feature it is) + 1

and only where that is not zero. On a convex body exactly one feature of it remains per node.

A ball is a node with a radius: the nodes of the other body measure their contact with it, and its
faces guard with theirs; those between the nodes of a quadratic element are chords of a curved face
and may reach into the ball a little (``ball_inset``). A plane meets the nodes of the other body.

Within one body the faces around a node do not exist for it, and no pair repels beyond half of its
distance at rest: neighbours at rest exert no force, however fine the mesh is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import SoftBody
from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.broad_phase.candidates import Candidates, PairList
from taccel_lab.ipc.contact.collision_lists import (
    CollisionLists,
    contact_geometry,
    sort_kernel,
)
from taccel_lab.ipc.contact.narrow_phase import (
    ContactSurface,
    edge_edge_kernel,
    node_face_kernel,
    node_plane_kernel,
)
from taccel_lab.ipc.device.ragged_lists import GrowingList, entry_types, initial_capacity
from taccel_lab.ipc.distance.closest_pairs import point_triangle_distance_sq
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, place_count
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import launch, side_by_side

wp.set_module_options({"enable_backward": False})

STIFF_KAPPA_PA = 1e6
"""Contact stiffness of a scene without soft bodies."""


def body_kappas(model: Model, kappa: float | None) -> wp.array:
    """Contact stiffness that each body asks for, and in the last column that between bodies that
    ask for none [Pa], float64, shape [1 or env_count, body_count + 1].

    ``kappa`` where one is given; else Young's modulus of a soft body, 0 for the others, and between
    these the largest modulus of the scene. A gel is thus pressed the same whatever else is in the
    scene: with the largest modulus for all contacts, the layer in front of a soft gel beside one a
    million times as stiff was nearly dhat thick, which raised its force by 3 %. Where moduli differ
    by environment (``Model.set_body``), so does the stiffness: it is that of a model built with the
    environment's moduli.
    """
    if kappa is None and model.scene.soft_bodies:
        return model.largest_moduli
    shape = (1, len(model.bodies) + 1)
    value = STIFF_KAPPA_PA if kappa is None else kappa
    return wp.full(shape, value, dtype=wp.float64, device=model.device)


def body_ranks(model: Model) -> np.ndarray:
    """Rank of each body, int32, shape [body_count]: of two, the higher one measures the contact.

    Soft bodies rank above stiff ones, which all rank the same. Among soft bodies the finer mesh
    ranks higher, by the mean length of its surface edges; equal ones rank the same. The mesh of the
    scene decides, not the rest shape of any environment, so that they stay independent.
    """
    sizes = []
    for body in model.scene.bodies:
        if isinstance(body, SoftBody):
            mesh = body.nodal_mesh
            ends = mesh.nodes_m[unique_edges(mesh.faces)]
            size = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()
            sizes.append(float(f"{size:.6g}"))
        else:
            sizes.append(np.inf)
    coarse_first = sorted({size for size in sizes if size < np.inf}, reverse=True)
    ranks = [1 + coarse_first.index(size) if size < np.inf else 0 for size in sizes]
    return np.array(ranks, dtype=np.int32)


@wp.kernel
def _self_range_kernel(
    bvh: wp.uint64,
    node_start: int,
    face_start: int,
    row: int,
    faces: wp.array(dtype=wp.vec3i),
    rest_positions: wp.array2d(dtype=wp.vec3d),
    ranges: wp.array2d(dtype=wp.float64),
):
    """Half of the rest distance to the nearest face that does not hold the node."""
    node = node_start + wp.tid()
    p = rest_positions[row, node]
    reach = wp.float64(2.0) * ranges[row, node]
    low = wp.vec3(p - wp.vec3d(reach, reach, reach))
    high = wp.vec3(p + wp.vec3d(reach, reach, reach))
    # The boxes are FP32: one rounding is at most 6e-8 of the value.
    slack = wp.float32(2.0e-7) * (wp.length(low) + wp.length(high))
    grow = wp.vec3(slack, slack, slack)
    query = wp.bvh_query_aabb(bvh, low - grow, high + grow)
    hit = int(0)
    nearest = reach * reach
    while wp.bvh_query_next(query, hit):
        face = faces[face_start + hit]
        if face[0] != node and face[1] != node and face[2] != node:
            distance_sq = point_triangle_distance_sq(
                p,
                rest_positions[row, face[0]],
                rest_positions[row, face[1]],
                rest_positions[row, face[2]],
            )
            nearest = wp.min(nearest, distance_sq)
    ranges[row, node] = wp.float64(0.5) * wp.sqrt(nearest)


def self_ranges(model: Model, dhat: float) -> wp.array:
    """Gap from which a node repels its own body [m], float64, shape [rest_count, node_count].

    The smaller of ``dhat`` and half of the distance to the rest of the surface at rest.
    """
    shape, device = (model.rest_count, model.node_count), model.device
    ranges = wp.full(shape, dhat, dtype=wp.float64, device=device)
    touching_itself = [a for a, b in model.contact_plan.pairs if a == b]
    if not touching_itself:
        return ranges
    rest = model.rest_positions.numpy()
    faces = model.surface.faces.numpy()
    for body in (model.bodies[i] for i in touching_itself):
        for row in range(model.rest_count):
            corners = rest[row, faces[slice(*body.faces)]]
            low = np.nextafter(corners.min(axis=1).astype(np.float32), np.float32(-np.inf))
            high = np.nextafter(corners.max(axis=1).astype(np.float32), np.float32(np.inf))
            tree = wp.Bvh(
                wp.array(low, dtype=wp.vec3, device=device),
                wp.array(high, dtype=wp.vec3, device=device),
            )
            inputs = [tree.id, body.nodes[0], body.faces[0], row, model.surface.faces]
            inputs += [model.rest_positions, ranges]
            launch(_self_range_kernel, body.nodes[1] - body.nodes[0], *inputs)
    return ranges


GUARD_FRACTION = 0.4
"""Range of the guard as part of dhat. Smaller leaves more pressure to the contact alone and brings
forces nearer to those of dhat = 0; larger takes fewer Newton iterations where edges rub (0.25: a
tenth more, 0.5: a tenth less)."""


class Collisions(GrowingList):
    """The active collisions of each environment at one set of positions.

    Collisions are appended by an atomic counter. On the CPU, which runs threads in turn, their
    order and hence every bit of the sums over them is reproducible; on a GPU the order varies from
    run to run, and the sums with it in the last digits, unless they are sorted.
    """

    columns: ClassVar = entry_types(CollisionLists)
    kinds: wp.array
    """POINT_TRIANGLE to POINT_PLANE, shape [capacity] as all below."""
    stencils: wp.array
    """Nodes; unused entries repeat the last one."""
    stiffnesses: wp.array
    """kappa * area * coefficient [N]."""
    thresholds: wp.array
    """Mollifier threshold of an edge pair [m^4], -1 for others."""
    ranges: wp.array
    """Gap below which the collision repels [m]."""
    insets: wp.array
    """How far a face may reach into a ball [m], 0 for others."""

    def __init__(
        self,
        model: Model,
        kappa: float | None,
        dhat: float,
        room: int | None = None,
        limit: int = 1 << 20,
        in_order: bool = False,
    ) -> None:
        """``room``, ``limit``: collisions of an environment that there is room for at first, and
        that there may be. ``kappa``, ``dhat``: as the attributes. ``in_order``: whether they are
        sorted by kind and stencil."""
        at_first = initial_capacity(model.env_count) if room is None else room
        self._in_order = in_order
        self._found: CollisionLists | None = None
        """What searches write: ``lists``, unless these are sorted from it."""
        super().__init__(model.env_count, model.device, at_first, limit)
        if in_order:
            self.entry_bytes *= 2
        self.model = model
        self.kappa = kappa
        """Barrier stiffness of all contacts [Pa], contact pressure at a gap of about half of dhat;
        None where the bodies in contact decide (``body_kappas``)."""
        self.dhat = dhat
        """Gap at which contact begins [m]."""
        self.guard = GUARD_FRACTION * dhat
        """Gap at which the guard begins [m]."""
        self.geometry = contact_geometry(model)
        self.surface = self._contact_surface()
        """Data of all surfaces for a search."""

    def _contact_surface(self) -> ContactSurface:
        model, source = self.model, self.model.surface
        surface = ContactSurface()
        for name in ContactSurface.vars.keys() & vars(source):
            setattr(surface, name, getattr(source, name))
        surface.rest_positions = model.rest_positions
        surface.self_ranges = self_ranges(model, self.dhat)
        surface.body_ranks = wp.array(body_ranks(model), dtype=wp.int32, device=model.device)
        surface.body_kappas = body_kappas(model, self.kappa)
        self._moduli = model.largest_moduli
        surface.dhat, surface.guard = self.dhat, self.guard
        return surface

    def _allocate(self, rooms: int | np.ndarray, most: int = 0) -> None:
        moves = self.moves
        super()._allocate(rooms, most)
        self.lists = CollisionLists()
        """All of it for kernels."""
        self.lists.room = self.room
        for name in self.columns:
            setattr(self.lists, name, getattr(self, name))
        if not self._in_order:
            self._found = self.lists
        elif self._found is None or self.moves > moves:
            self._found = found = CollisionLists()
            found.room = self.room
            for name, dtype in self.columns.items():
                setattr(found, name, wp.zeros(self.capacity, dtype, device=self.device))

    def update(self, active: EnvMask, positions: wp.array, candidates: Candidates) -> None:
        """``collect`` by a host that makes room where it is short."""
        while True:
            self.collect(active, positions, candidates)
            if not self.fit():
                return

    def collect(self, active: EnvMask, positions: wp.array, candidates: Candidates) -> None:
        """Collect the collisions among ``candidates`` at ``positions``, for active environments;
        the lists of others stay as they are."""
        self.clear(active)
        side_by_side(self.model.device, self.searches(active, positions, candidates))
        self.settle(active)

    def searches(
        self, active: EnvMask, positions: wp.array, candidates: Candidates
    ) -> list[Callable[[], None]]:
        """Launches, in any order or side by side, that add the collisions among ``candidates`` at
        ``positions`` to the lists of active environments, which then are to be ``settle``d."""
        model, plan = self.model, self.model.contact_plan
        if self._moduli is not model.largest_moduli:
            # They differ by environment since.
            self.surface.body_kappas = body_kappas(model, self.kappa)
            self._moduli = model.largest_moduli
        common = [positions, self.geometry, self.surface]

        def narrow(kernel: wp.Kernel, pairs: PairList) -> None:
            lanes = lane_count(model.device, place_count(active), pairs.largest_room)
            inputs = [active, lanes, pairs.room, pairs.pairs, *common, self._found]
            launch(kernel, (model.env_count, lanes), *inputs)

        def narrow_planes() -> None:
            inputs = [active, plan.node_plane, model.present, *common, self._found]
            launch(node_plane_kernel, (model.env_count, len(plan.node_plane)), *inputs)

        searches: list[Callable[[], None]] = []
        if candidates.node_faces.capacity:
            searches.append(lambda: narrow(node_face_kernel, candidates.node_faces))
        if candidates.edge_edges.capacity:
            searches.append(lambda: narrow(edge_edge_kernel, candidates.edge_edges))
        if len(plan.node_plane):
            searches.append(narrow_planes)
        return searches

    def settle(self, active: EnvMask) -> None:
        """Bring what ``searches`` have found in active environments in order, if it shall be."""
        if not self._in_order:
            return
        lanes = lane_count(self.device, len(active), self.largest_room)
        launch(sort_kernel, (len(active), lanes), active, lanes, self._found, self.lists)

    def snapshot(self, env: int) -> dict[str, np.ndarray]:
        """Collisions of one environment, sorted by kind and stencil: the same on every device."""
        found = {name: self.of(env, getattr(self, name)) for name in self.columns}
        keys = np.column_stack([found["kinds"], found["stencils"]])
        order = np.lexsort(keys.T[::-1])
        return {name: value[order] for name, value in found.items()}
