# SPDX-License-Identifier: Apache-2.0
"""Search among soft bodies, a body against itself included.

One tree over the swept boxes of all their faces and one over their edges, with a group for each
environment that has needed them. The trees keep the shape that they have of bodies at rest, and are
refitted, as connectivity does not change. Boxes around whole bodies come first: where none is near
another, and none may touch itself, the trees are not even refitted. Until a body first is, its
environment has no group: of a peg between two gels it would take a quarter of the memory. An
environment that needs one takes its step again, as one whose lists were too short.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.boxes import append, find_body_boxes, rounded_out
from taccel_lab.ipc.broad_phase.sieve import edges_may_meet, node_may_meet
from taccel_lab.ipc.device.ragged_lists import GrowingList, ListRoom, room_for
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})


@wp.func
def _swept(
    low: wp.vec3d,
    high: wp.vec3d,
    env: int,
    node: int,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    a = positions[env, node]
    b = a + displacements[env, node]
    return wp.min(low, wp.min(a, b)), wp.max(high, wp.max(a, b))


@wp.kernel
def _boxes_kernel(
    environments: wp.array(dtype=wp.int32),
    primitives: wp.array2d(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    lower: wp.array2d(dtype=wp.vec3),
    upper: wp.array2d(dtype=wp.vec3),
):
    """Box of the path of each face or edge, given by its nodes, in those environments; -1: none."""
    slot, i = wp.tid()
    env = environments[slot]
    if env < 0:
        return
    low = positions[env, primitives[i, 0]]
    high = low
    for k in range(primitives.shape[1]):
        low, high = _swept(low, high, env, primitives[i, k], positions, displacements)
    box = rounded_out(low, high, wp.float64(0.0))
    lower[slot, i] = box.lower
    upper[slot, i] = box.upper


@wp.kernel
def _near_kernel(
    active: wp.array(dtype=wp.int32),
    may_touch: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    lower: wp.array2d(dtype=wp.vec3d),
    upper: wp.array2d(dtype=wp.vec3d),
    near: wp.array2d(dtype=wp.int32),
    any_near: wp.array(dtype=wp.int32),
    trees: ListRoom,
):
    """Whether a body comes near a soft body that it may touch, itself included. Then its
    environment needs trees, and is searched once it has them."""
    env, body = wp.tid()
    near[env, body] = 0
    if active[env] == 0:
        return
    for other in range(lower.shape[1]):
        if may_touch[body, other] != 0:
            gap = wp.max(
                wp.max(lower[env, body] - upper[env, other]),
                wp.max(lower[env, other] - upper[env, body]),
            )
            if gap <= margins[env]:
                trees.counts[env] = 1
                if room_for(env, trees) > 0:
                    near[env, body] = 1
                    any_near[0] = 1


@wp.kernel
def _node_kernel(
    near: wp.array2d(dtype=wp.int32),
    trees: ListRoom,
    tree: wp.uint64,
    nodes: wp.array(dtype=wp.int32),
    items: wp.array(dtype=wp.int32),
    faces: wp.array(dtype=wp.vec3i),
    node_bodies: wp.array(dtype=wp.int32),
    may_touch: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    room: ListRoom,
    pairs: wp.array(dtype=wp.vec2i),
):
    env, i = wp.tid()
    node = nodes[i]
    if near[env, node_bodies[node]] == 0:
        return
    low = positions[env, node]
    high = low
    low, high = _swept(low, high, env, node, positions, displacements)
    box = rounded_out(low, high, margins[env])
    root = wp.bvh_get_group_root(tree, trees.starts[env])
    query = wp.bvh_query_aabb(tree, box.lower, box.upper, root)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        item = items[hit % items.shape[0]]
        face = faces[item]
        if may_touch[node_bodies[node], node_bodies[face[0]]] != 0:
            if face[0] != node and face[1] != node and face[2] != node:
                if node_may_meet(node, face, margins[env], positions[env], displacements[env]):
                    append(env, node, item, room, pairs)


@wp.kernel
def _edge_kernel(
    near: wp.array2d(dtype=wp.int32),
    trees: ListRoom,
    tree: wp.uint64,
    items: wp.array(dtype=wp.int32),
    edges: wp.array(dtype=wp.vec2i),
    node_bodies: wp.array(dtype=wp.int32),
    may_touch: wp.array2d(dtype=wp.int32),
    margins: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    room: ListRoom,
    pairs: wp.array(dtype=wp.vec2i),
):
    env, i = wp.tid()
    mine = items[i]
    a = edges[mine]
    if near[env, node_bodies[a[0]]] == 0:
        return
    low = positions[env, a[0]]
    high = low
    for k in range(2):
        low, high = _swept(low, high, env, a[k], positions, displacements)
    box = rounded_out(low, high, margins[env])
    root = wp.bvh_get_group_root(tree, trees.starts[env])
    query = wp.bvh_query_aabb(tree, box.lower, box.upper, root)
    hit = int(0)
    while wp.bvh_query_next(query, hit):
        other = items[hit % items.shape[0]]
        b = edges[other]
        # Each pair once, and not with an edge that shares a node.
        if mine < other and may_touch[node_bodies[a[0]], node_bodies[b[0]]] != 0:
            if a[0] != b[0] and a[0] != b[1] and a[1] != b[0] and a[1] != b[1]:
                if edges_may_meet(a, b, margins[env], positions[env], displacements[env]):
                    append(env, mine, other, room, pairs)


_ITEM_BYTES = 160
"""Memory of a face or an edge: its box, two nodes of the tree, and as much again while it is sorted
as a tree is built."""


class SoftTrees(GrowingList):
    """Refitted trees of the soft bodies that may touch one another, as a list of one entry in each
    environment that needs them: its boxes, and a group of the trees."""

    columns: ClassVar = {}
    # They come one by one, and each time all trees are made anew.
    spare: ClassVar = 1.0

    def __init__(self, model: Model) -> None:
        self.model = model
        self._faces = self._nodes_of(model.surface.faces, model.contact_plan.soft_faces)
        self._edges = self._nodes_of(model.surface.edges, model.contact_plan.soft_edges)
        self._soft_bodies = model.bodies[: len(model.scene.soft_bodies)]
        nodes = [body.nodes for body in self._soft_bodies]
        device, shape = model.device, (model.env_count, len(nodes))
        self._body_nodes = wp.array(nodes, dtype=wp.vec2i, device=device)
        self._lower = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self._upper = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self._near = wp.zeros(shape, dtype=wp.int32, device=device)
        self._any_near = wp.zeros(1, dtype=wp.int32, device=device)
        self._trees: list[wp.Bvh] = []
        self._boxes: list[tuple[wp.array, wp.array]] = []
        """Lower and upper corners of the boxes of faces, and of edges, vec3, [capacity, count]."""
        super().__init__(model.env_count, device, room=0, limit=1)
        self.entry_bytes = _ITEM_BYTES * (len(self._faces) + len(self._edges))

    def _nodes_of(self, primitives: wp.array, items: wp.array) -> wp.array:
        """Nodes of the primitives that are searched, int32, shape [count, 3 or 2]."""
        nodes = primitives.numpy()[items.numpy()]
        return wp.array(nodes, dtype=wp.int32, device=self.model.device)

    def _allocate(self, rooms: int | np.ndarray, most: int = 0) -> None:
        """Make boxes and trees for the environments that there is room in, anew if they are too
        few.

        The host makes them here, and no search does: it may be part of a graph that is captured.
        """
        moves = self.moves
        super()._allocate(np.minimum(rooms, self.limit), most)
        envs = np.full(self.capacity, -1, dtype=np.int32)
        needing = np.flatnonzero(self.rooms)
        envs[: len(needing)] = needing
        if self.moves == moves and self.capacity:
            self._environments.assign(envs)
            return
        self._environments = wp.array(envs, dtype=wp.int32, device=self.device)
        """Environment of each row of boxes, and of each group, -1 for those to spare, int32, shape
        [capacity]."""
        # The old ones go first: there is not always memory for both.
        self._trees, self._boxes = [], []
        if self.capacity:
            self._build()

    def _build(self) -> None:
        """Make boxes and trees: the first boxes, of bodies at rest, decide the shape of the trees.

        By those of a direction that leads astray trees would stay bad, and the order of pairs would
        depend on who needs trees when.
        """
        nodes = self._rest_in_a_row()
        counts = (len(self._faces), len(self._edges))
        self._boxes = [(self._corners(count), self._corners(count)) for count in counts]
        first = wp.zeros(self.capacity, dtype=wp.int32, device=self.device)
        self._fit_boxes(first, nodes, wp.zeros_like(nodes))
        for (lower, upper), count in zip(self._boxes, counts, strict=True):
            groups = np.repeat(np.arange(self.capacity, dtype=np.int32), count)
            of_items = wp.array(groups, dtype=wp.int32, device=self.device)
            self._trees.append(wp.Bvh(lower.flatten(), upper.flatten(), groups=of_items))

    def _corners(self, count: int) -> wp.array:
        return wp.zeros((self.capacity, count), dtype=wp.vec3, device=self.device)

    def _rest_in_a_row(self) -> wp.array:
        """Nodes at rest [m], vec3d, [1, node_count]: one soft body beside the other, as those on
        mounts may be in the same place."""
        # A copy, as the CPU's is the model's own memory.
        rest = self.model.rest_positions.numpy()[:1].copy()
        end = 0.0
        for body in self._soft_bodies:
            along = rest[:, body.node_slice, 0]
            along += end - along.min()
            # Without a gap parts of two bodies share branches, and a search takes twice as long.
            end = along.max() + np.ptp(along)
        return wp.array(rest, dtype=wp.vec3d, device=self.device)

    def _fit_boxes(
        self, environments: wp.array, positions: wp.array, displacements: wp.array
    ) -> None:
        for nodes, boxes in zip((self._faces, self._edges), self._boxes, strict=True):
            inputs = [environments, nodes, positions, displacements]
            launch(_boxes_kernel, boxes[0].shape, *inputs, *boxes)

    def _find_near(
        self, active: EnvMask, positions: wp.array, displacements: wp.array, margins: wp.array
    ) -> None:
        self._any_near.zero_()
        boxes = (self._lower, self._upper)
        find_body_boxes(active, self._body_nodes, positions, displacements, *boxes)
        inputs = [active, self.model.contact_plan.may_touch, margins, self._lower, self._upper]
        launch(_near_kernel, self._near.shape, *inputs, self._near, self._any_near, self.room)

    def search(
        self,
        active: EnvMask,
        positions: wp.array,
        displacements: wp.array,
        margins: wp.array,
        node_face: list,
        edge_edge: list,
    ) -> None:
        """Append to the lists (room, pairs) what may come within ``margins`` [m], [env_count]; only
        note where there should be trees while there are none."""
        self._find_near(active, positions, displacements, margins)
        if not self.capacity:
            return

        def search_trees() -> None:
            self._fit_boxes(self._environments, positions, displacements)
            for tree in self._trees:
                tree.refit()
            self._search(positions, displacements, margins, node_face, edge_edge)

        wp.capture_if(self._any_near, on_true=search_trees)

    def _search(
        self,
        positions: wp.array,
        displacements: wp.array,
        margins: wp.array,
        node_face: list,
        edge_edge: list,
    ) -> None:
        model, plan, surface = self.model, self.model.contact_plan, self.model.surface
        rules = [surface.node_bodies, plan.may_touch, margins, positions, displacements]
        faces, edges = ([self._near, self.room, tree.id] for tree in self._trees)
        inputs = [*faces, plan.soft_nodes, plan.soft_faces, surface.faces, *rules, *node_face]
        launch(_node_kernel, (model.env_count, len(plan.soft_nodes)), *inputs)
        inputs = [*edges, plan.soft_edges, surface.edges, *rules, *edge_edge]
        launch(_edge_kernel, (model.env_count, len(plan.soft_edges)), *inputs)
