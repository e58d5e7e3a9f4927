# SPDX-License-Identifier: Apache-2.0
"""Does an edge really pass through a face? Decided in exact rational arithmetic.

The fast test in floating point counts volumes within rounding as zero and touching as crossing, so
that it misses nothing; faces that are flat slivers in one plane with an edge then count as well.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from taccel_lab.bodies.crossings import crossing_pairs
from taccel_lab.bodies.primitives import Ball, unique_edges
from taccel_lab.ipc.contact.overlap_search import Overlap, OverlapKind
from taccel_lab.model import Model
from taccel_lab.scene import SoftBody

Point = tuple[Fraction, Fraction, Fraction]


def _exact(point: np.ndarray) -> Point:
    x, y, z = (Fraction(float(value)) for value in point)
    return x, y, z


def _volume(a: Point, b: Point, c: Point, d: Point) -> Fraction:
    """Six times the signed volume of a tet."""
    u, v, w = ([p[k] - a[k] for k in range(3)] for p in (b, c, d))
    return (
        u[0] * (v[1] * w[2] - v[2] * w[1])
        - u[1] * (v[0] * w[2] - v[2] * w[0])
        + u[2] * (v[0] * w[1] - v[1] * w[0])
    )


def pierces(segment: np.ndarray, triangle: np.ndarray) -> bool:
    """Whether a segment [2, 3] meets a triangle [3, 3] that it does not lie in a plane with."""
    p, q = _exact(segment[0]), _exact(segment[1])
    a, b, c = (_exact(corner) for corner in triangle)
    above, below = _volume(a, b, c, p), _volume(a, b, c, q)
    if above * below > 0 or above == below == 0:
        return False
    sides = [_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)]
    return all(side >= 0 for side in sides) or all(side <= 0 for side in sides)


def really_cross(model: Model, x: np.ndarray, item: Overlap) -> bool:
    """Whether any of the crossings that were found between two bodies is one.

    ``x``: node positions of the environment [node_count, 3]. What is no crossing of surfaces is
    taken as it is.
    """
    if item.kind not in (OverlapKind.CROSSING, OverlapKind.SELF_CROSSING):
        return True
    surfaces = [_surface(model, x, name) for name in (item.first, item.second)]
    if any(len(faces) == 0 for _, faces in surfaces):
        return True
    same = item.first == item.second
    for (nodes, faces), (others, around) in (surfaces, surfaces[::-1]):
        edges = unique_edges(faces).astype(np.int64)
        ids = (edges, around) if same else (None, None)
        edge, face = crossing_pairs(nodes[edges], others[around], *ids)
        pairs = zip(nodes[edges[edge]], others[around[face]], strict=True)
        if any(pierces(segment, triangle) for segment, triangle in pairs):
            return True
    return False


def _surface(model: Model, x: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and faces of a body; no faces of a ball or a plane."""
    index = model.body_id(name)
    body, nodes = model.scene.bodies[index], x[model.bodies[index].node_slice]
    mesh = body.nodal_mesh if isinstance(body, SoftBody) else getattr(body, "shape", None)
    if mesh is None or isinstance(mesh, Ball):
        return nodes, np.zeros((0, 3), dtype=np.int64)
    return nodes, mesh.faces.astype(np.int64)
