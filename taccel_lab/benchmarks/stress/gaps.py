# SPDX-License-Identifier: Apache-2.0
"""Gaps between the surfaces of one environment, in numpy: a referee of the contact search.

The distance of two triangle surfaces is that of a vertex of one from a face of the other, or of two
edges. What two bodies keep from each other, the radius of a ball or a thickness, is taken off. A
curved face may reach into a ball by an inset (``surface_topology``), its nodes may not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.bodies.box_pairs import box_pairs
from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.bodies.surface_topology import ball_insets
from taccel_lab.model import Model


@dataclass(frozen=True)
class Gaps:
    """Pairs of primitives of different bodies nearer than a limit; arrays of one length."""

    bodies: np.ndarray
    """Body ids, shape [n, 2]."""
    gaps_m: np.ndarray
    """Distance less what the bodies keep from each other [m], shape [n]."""
    kinds: np.ndarray
    """Row of ``KINDS``, shape [n]."""
    items: np.ndarray
    """Global node, face or edge numbers of the pair, shape [n, 2]."""

    KINDS = (("node", "face"), ("edge", "edge"), ("node", "plane node"))

    def where(self, pair: int) -> str:
        """The primitives of a pair, for a message."""
        first, second = self.KINDS[self.kinds[pair]]
        return f"{first} {self.items[pair, 0]} and {second} {self.items[pair, 1]}"


class SurfacePairs:
    """Collision surfaces of a model and which of them may touch, on the host."""

    def __init__(self, model: Model) -> None:
        s = model.surface
        self.faces = s.faces.numpy().astype(np.int64).reshape(-1, 3)
        self.edges = s.edges.numpy().astype(np.int64).reshape(-1, 2)
        self.node_bodies = s.node_bodies.numpy()
        self.radii = s.node_radii.numpy()
        self.normals = s.plane_normals.numpy()
        self.planes = np.flatnonzero(self.normals.any(axis=1))
        self.is_ball = s.node_is_ball.numpy() != 0
        balls = np.flatnonzero(self.is_ball)
        self.face_reaches_sq = s.face_reaches_sq.numpy()[0]
        """How far faces may reach into balls: no case has rest shapes of its own."""
        self.points = np.union1d(np.unique(self.faces), balls)
        """Nodes that can touch something."""
        self.may_touch = np.zeros((len(model.bodies), len(model.bodies)), dtype=bool)
        for i, j in model.contact_plan.pairs:
            self.may_touch[i, j] = self.may_touch[j, i] = i != j

    def nearer_than(self, x: np.ndarray, present: np.ndarray, limit_m: float) -> Gaps:
        """All pairs with a gap below ``limit_m``, of bodies that may touch and are present.

        ``x``: node positions [node_count, 3] [m]; ``present``: bool, [body_count].
        """
        touch = self.may_touch & present & present[:, None]
        parts = [self._points_to_faces(x, touch, limit_m)]
        parts.append(self._edges_to_edges(x, touch, limit_m))
        parts.append(self._points_to_planes(x, touch))
        kinds = np.repeat(np.arange(3), [len(part[0]) for part in parts])
        first, second, node_a, node_b, distance = (
            np.concatenate([part[k] for part in parts]) for k in range(5)
        )
        gaps = distance - self.radii[node_a] - self.radii[node_b]
        near = gaps < limit_m
        return Gaps(
            bodies=np.stack([self.node_bodies[node_a], self.node_bodies[node_b]], axis=1)[near],
            gaps_m=gaps[near],
            kinds=kinds[near],
            items=np.stack([first, second], axis=1)[near],
        )

    def _boxes(
        self, x: np.ndarray, nodes: np.ndarray, margin: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Boxes of primitives [n, corners], grown by what their bodies keep and half a margin."""
        reach = (self.radii[nodes[:, 0]] + 0.5 * margin)[:, None]
        return x[nodes].min(axis=1) - reach, x[nodes].max(axis=1) + reach

    def _candidates(
        self, x: np.ndarray, touch: np.ndarray, first: np.ndarray, second: np.ndarray, margin: float
    ) -> tuple[np.ndarray, np.ndarray]:
        a, b = box_pairs(self._boxes(x, first, margin), self._boxes(x, second, margin))
        keep = touch[self.node_bodies[first[a, 0]], self.node_bodies[second[b, 0]]]
        return a[keep], b[keep]

    def _points_to_faces(
        self, x: np.ndarray, touch: np.ndarray, margin: float
    ) -> tuple[np.ndarray, ...]:
        a, face = self._candidates(x, touch, self.points[:, None], self.faces, margin)
        node = self.points[a]
        distance = point_triangle_distances(x[node], x[self.faces[face]])
        ball = np.flatnonzero(self.is_ball[node])
        reaches_sq = self.face_reaches_sq[face[ball]]
        to_nodes = np.linalg.norm(x[self.faces[face[ball]]] - x[node[ball], None], axis=2)
        distance[ball] = np.minimum(
            distance[ball] + ball_insets(self.radii[node[ball]], reaches_sq), to_nodes.min(axis=1)
        )
        return node, face, node, self.faces[face, 0], distance

    def _edges_to_edges(
        self, x: np.ndarray, touch: np.ndarray, margin: float
    ) -> tuple[np.ndarray, ...]:
        a, b = self._candidates(x, touch, self.edges, self.edges, margin)
        a, b = a[a < b], b[a < b]
        distance = closest_on_edges(x[self.edges[a]], x[self.edges[b]])[2]
        return a, b, self.edges[a, 0], self.edges[b, 0], distance

    def _points_to_planes(self, x: np.ndarray, touch: np.ndarray) -> tuple[np.ndarray, ...]:
        node, plane = (v.ravel() for v in np.meshgrid(self.points, self.planes))
        keep = touch[self.node_bodies[node], self.node_bodies[plane]]
        node, plane = node[keep].astype(int), plane[keep].astype(int)
        distance = ((x[node] - x[plane]) * self.normals[plane]).sum(axis=1)
        return node, plane, node, plane, distance


def closest_on_edges(
    first: np.ndarray, second: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points at which segments [n, 2, 3] come closest to their partners [n, 2, 3], as parts of
    their lengths from 0 to 1, and the distance there [m]; each of shape [n]."""
    p, q = first[:, 0], second[:, 0]
    u, v = first[:, 1] - p, second[:, 1] - q
    start, end = np.zeros(len(p)), np.ones(len(p))
    normal = np.cross(u, v)
    pairs = (
        (start, part_along(p - q, v)),
        (end, part_along(p + u - q, v)),
        (part_along(q - p, u), start),
        (part_along(q + v - p, u), end),
        # Inside both: where the common normal meets them.
        (part_along(np.cross(q - p, v), normal), part_along(np.cross(q - p, u), normal)),
    )
    s, t = np.stack(pairs, axis=1)
    off = p + s[..., None] * u - q - t[..., None] * v
    distance = np.linalg.norm(off, axis=-1)
    best = distance.argmin(axis=0), np.arange(len(p))
    return s[best], t[best], distance[best]


def part_along(offset: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Parts of vectors ``along`` [n, 3] at which offsets [n, 3] stand, cut to 0 to 1, shape [n]."""
    length_sq = (along * along).sum(axis=1)
    return np.clip((offset * along).sum(axis=1) / np.where(length_sq > 0, length_sq, 1.0), 0.0, 1.0)
