# SPDX-License-Identifier: Apache-2.0
"""Bodies that overlap, found on the device: which environments start so, and what is where.

Two closed surfaces overlap where an edge of one passes through a face of the other, or where one
lies inside the other as a whole, which the winding number of its faces about one node of each part
tells. Only bodies that may touch are looked at, a soft body with itself where it has self-contact.
Surfaces that only touch in a plane they share are not told apart from surfaces that do not.
Thickness is left out: it is a distance to keep, not a body. Curved faces may reach into a ball by
an inset, their nodes may not.

A thread has an edge and goes through the faces of the other body, if that edge reaches into the box
around it: work is edges times faces in that box alone, and a new start among thousands of running
environments costs those microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import warp as wp

from taccel_lab.bodies.primitives import Ball
from taccel_lab.bodies.surface_topology import is_closed, one_node_of_each_part
from taccel_lab.errors import InputError
from taccel_lab.ipc.broad_phase.boxes import find_body_boxes
from taccel_lab.ipc.contact.overlap_kernels import (
    Findings,
    Surfaces,
    ball_overlaps_kernel,
    begin_overlaps_kernel,
    below_plane_kernel,
    crossing_kernel,
    inside_kernel,
)
from taccel_lab.model import BodyKind, Model
from taccel_lab.model.launches import CapturedWork, launch, launch_blocks
from taccel_lab.state import State, check_state

_INSIDE, _BELOW, _BALL, _CROSSING = range(4)
"""Kinds of jobs. Of several that find a pair the last one is named: crossings before insides."""


class OverlapKind(StrEnum):
    """How two bodies overlap."""

    CROSSING = "crossing"
    """An edge of one surface passes through a face of the other, or the ball reaches a face."""
    SELF_CROSSING = "crossing itself"
    INSIDE = "inside"
    """The first body, or a separate part of it, is inside the second as a whole."""
    BELOW_PLANE = "below a plane"


@dataclass(frozen=True)
class Overlap:
    """Two bodies that overlap in one environment."""

    kind: OverlapKind
    first: str
    """Name of a body; of two, the stiffer one unless the other is inside it or below it."""
    second: str
    """Name of the other body; the same where a body crosses itself."""
    point_m: np.ndarray
    """One place where it happens [m], shape [3]."""
    where: str
    """An edge, face or node there, by numbers of nodes in its body's own mesh."""


class OverlapSearch:
    """Overlaps of the bodies of a model that may touch."""

    def __init__(self, model: Model, captured: bool = True) -> None:
        """``captured``: whether a second search of the same arrays is launched as a graph."""
        self._model = model
        self._graph = CapturedWork(model.device, captured)
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

        plan = model.contact_plan
        self._jobs = [put(inside), plan.node_plane, plan.ball_face, put(crossing)]
        self._first_jobs = np.cumsum([0, *(len(jobs) for jobs in self._jobs)]).tolist()
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
        pair_ids = np.zeros((len(model.bodies),) * 2, dtype=np.int32)
        for number, (first, second) in enumerate(plan.pairs):
            pair_ids[first, second] = pair_ids[second, first] = number
        self._bodies.pair_ids = wp.array(pair_ids, dtype=wp.int32, device=device)
        self._searched = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        self._found = Findings()
        self._found.envs = wp.zeros(model.env_count, dtype=wp.int32, device=device)
        shape = (model.env_count, len(plan.pairs))
        self._found.jobs = wp.zeros(shape, dtype=wp.int32, device=device)

    def _ball_radii(self) -> np.ndarray:
        """Radius without thickness of the ball of each job [m]."""
        model = self._model
        shapes = [getattr(body, "shape", None) for body in model.scene.bodies]
        radii = np.array([s.radius_m if isinstance(s, Ball) else 0.0 for s in shapes])
        nodes = model.contact_plan.ball_face.numpy().reshape(-1, 2)[:, 0]
        return radii[model.surface.node_bodies.numpy()[nodes]]

    def mark(self, x: wp.array, mask: wp.array) -> None:
        """Leave in ``mask`` (int32, [env_count]) only the environments in which bodies overlap.

        ``x``: node positions [m], vec3d, [env_count, node_count]. Environments in which one is not
        finite are none of them.
        """
        self._graph.launch((self._model.moves, x.ptr, mask.ptr), lambda: self._mark(x, mask))

    def _mark(self, x: wp.array, mask: wp.array) -> None:
        surface = self._model.surface
        self._found.envs.zero_()
        self._found.jobs.zero_()
        wp.copy(self._searched, mask)
        launch(begin_overlaps_kernel, x.shape, mask, x, self._searched)
        bodies = self._bodies
        find_body_boxes(self._searched, self._body_nodes, x, None, bodies.lower, bodies.upper)
        self._launch(below_plane_kernel, _BELOW, [surface.plane_normals], x)
        self._launch(ball_overlaps_kernel, _BALL, [surface.face_reaches_sq, self._radii], x)
        self._launch(crossing_kernel, _CROSSING, [], x)
        # Last, as the others leave alone bodies that are known to overlap.
        self._launch(inside_kernel, _INSIDE, [], x)
        wp.copy(mask, self._found.envs)

    def _launch(self, kernel: wp.Kernel, kind: int, inputs: list, x: wp.array) -> None:
        """A thread an environment and job of a kind, a block of them for what may be inside."""
        jobs = self._jobs[kind]
        if not len(jobs):
            return
        start = launch_blocks if kind == _INSIDE else launch
        inputs = [self._searched, jobs, *inputs, self._bodies, x, self._first_jobs[kind]]
        start(kernel, (self._model.env_count, len(jobs)), *inputs, self._found)

    def describe(self, state: State) -> list[list[Overlap]]:
        """What the last search found, one for each pair of bodies, by environment."""
        jobs, x = self._found.jobs.numpy(), state.positions.numpy()
        return [
            [
                self._overlap(int(pair), int(jobs[env, pair]) - 1, x[env])
                for pair in np.flatnonzero(jobs[env])
            ]
            for env in range(self._model.env_count)
        ]

    def _overlap(self, pair: int, job: int, x: np.ndarray) -> Overlap:
        """The finding of a job; ``x``: node positions of the environment [m], [node_count, 3]."""
        model, surface = self._model, self._model.surface
        softer, stiffer = (model.bodies[body] for body in model.contact_plan.pairs[pair])
        kind = int(np.searchsorted(self._first_jobs, job, side="right")) - 1
        item, other = self._jobs[kind].numpy()[job - self._first_jobs[kind]].tolist()
        if kind == _CROSSING:
            what, nodes = "edge", surface.edges.numpy()[item]
        elif kind == _BALL:
            what, nodes = "face", surface.faces.numpy()[other]
        else:
            what, nodes = "node", np.array([item])
        owner = model.bodies[surface.node_bodies.numpy()[nodes[0]]]
        own = ", ".join(str(node - owner.nodes[0]) for node in nodes)
        names, found = (stiffer.name, softer.name), OverlapKind.CROSSING
        if kind == _INSIDE:
            names, found = (owner.name, model.bodies[other].name), OverlapKind.INSIDE
        elif kind == _BELOW:
            names, found = (softer.name, stiffer.name), OverlapKind.BELOW_PLANE
        elif softer is stiffer:
            found = OverlapKind.SELF_CROSSING
        where = f"{what} {own} of {owner.name!r}"
        return Overlap(found, *names, x[nodes].mean(axis=0), where)


def find_overlaps(model: Model, state: State) -> list[list[Overlap]]:
    """All pairs of bodies that may touch and overlap: one list for each environment."""
    check_state(state, model)
    search = OverlapSearch(model)
    everyone = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
    search.mark(state.positions, everyone)
    return search.describe(state)


def require_separated(model: Model, state: State) -> None:
    """Refuse a state in which bodies that may touch overlap.

    Raises:
        InputError: with environment, bodies and place.
    """
    for env, found in enumerate(find_overlaps(model, state)):
        for item in found:
            x, y, z = item.point_m * 1e3
            where = f"in environment {env}, near x {x:.3f}, y {y:.3f}, z {z:.3f} mm ({item.where})"
            if item.kind is OverlapKind.SELF_CROSSING:
                raise InputError(f"{item.first!r} crosses itself {where}")
            raise InputError(
                f"{item.first!r} starts inside {item.second!r} {where} ({item.kind}); "
                "allowed: a start with a gap everywhere between bodies that may touch"
            )
