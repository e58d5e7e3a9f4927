# SPDX-License-Identifier: Apache-2.0
"""The contact potential as plain sums over all primitives, with ipctk distances.

Nodes of one surface against another, as the inclusion-exclusion sum without any merging:
sum_nodes A_i [sum_faces b(d) - sum_inner edges b(d) + sum_inner vertices b(d)]; and all pairs of
edges.
"""

from __future__ import annotations

from collections import Counter

import ipctk
import numpy as np

from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.contact.collisions import GUARD_FRACTION, body_ranks, self_ranges
from taccel_lab.model import Model


def log_barrier(distance: float, reach: float) -> float:
    """reach g(d / reach) [m]."""
    y = distance / reach
    return -reach * (y - 1) ** 2 * np.log(y) if y < 1 else 0.0


def face_areas(x: np.ndarray, faces: np.ndarray) -> np.ndarray:
    sides = (x[faces[:, k]] - x[faces[:, 0]] for k in (1, 2))
    return 0.5 * np.linalg.norm(np.cross(*sides), axis=1)


Array = np.ndarray


def node_face_sum(x: Array, faces: Array, others: Array, weights: Array, reaches: Array) -> float:
    """Energy over kappa of nodes ``others`` with ``weights`` [m^2] against a surface.

    ``reaches`` [m] per node. Faces that hold the node do not exist for it.
    """
    total = 0.0
    for p, weight, reach in zip(others, weights, reaches, strict=True):
        mine = faces[~(faces == p).any(axis=1)]
        uses = Counter(
            tuple(sorted(e)) for f in mine.tolist() for e in zip(f, f[1:] + f[:1], strict=True)
        )
        inner = [e for e, count in uses.items() if count == 2]
        rim = {v for e, count in uses.items() if count == 1 for v in e}
        vertices = [v for v in np.unique(mine) if v not in rim]
        terms = [ipctk.point_triangle_distance(x[p], *x[f]) for f in mine]
        terms += [ipctk.point_point_distance(x[p], x[v]) for v in vertices]
        subtracted = [ipctk.point_edge_distance(x[p], *x[list(e)]) for e in inner]
        total += weight * sum(log_barrier(d_sq**0.5, reach) for d_sq in terms)
        total -= weight * sum(log_barrier(d_sq**0.5, reach) for d_sq in subtracted)
    return total


def edge_areas(rest: np.ndarray, faces: np.ndarray) -> dict[tuple[int, ...], float]:
    """A third of the faces at each edge [m^2]."""
    found: dict[tuple[int, ...], float] = {}
    for face, area in zip(faces.tolist(), face_areas(rest, faces), strict=True):
        for e in zip(face, face[1:] + face[:1], strict=True):
            key = tuple(sorted(e))
            found[key] = found.get(key, 0.0) + area / 3
    return found


def edge_pair_sum(
    x: np.ndarray, rest: np.ndarray, first: np.ndarray, second: np.ndarray, reach: float
) -> float:
    itself = first is second
    area = edge_areas(rest, first) | edge_areas(rest, second)
    total = 0.0
    for a in map(tuple, unique_edges(first).tolist()):
        for b in map(tuple, unique_edges(second).tolist()):
            if itself and (a >= b or set(a) & set(b)):
                continue
            ends = [*x[list(a)], *x[list(b)]]
            apart = [*rest[list(a)], *rest[list(b)]]
            here = min(reach, 0.5 * ipctk.edge_edge_distance(*apart) ** 0.5) if itself else reach
            value = log_barrier(ipctk.edge_edge_distance(*ends) ** 0.5, here) if here > 0 else 0.0
            if value > 0:
                threshold = ipctk.edge_edge_mollifier_threshold(*apart)
                mollifier = ipctk.edge_edge_mollifier(*ends, threshold)
                total += 0.5 * min(area[a], area[b]) * mollifier * value
    return total


def plain_sum(model: Model, x: np.ndarray, dhat: float) -> float:
    """Energy over kappa of one body with itself or of two with each other, without thickness."""
    faces, guard = model.surface.faces.numpy(), GUARD_FRACTION * dhat
    rest, area = model.rest_positions.numpy()[0], model.surface.node_areas.numpy()[0]
    parts = [faces[slice(*body.faces)] for body in model.bodies]
    if len(parts) == 1:
        own = np.unique(parts[0])
        reach = self_ranges(model, dhat).numpy()[0, own]
        total = node_face_sum(x, parts[0], own, 0.5 * area[own], reach)
        return total + edge_pair_sum(x, rest, parts[0], parts[0], guard)
    ranks = body_ranks(model)
    total = edge_pair_sum(x, rest, parts[0], parts[1], guard)
    for mine, other in ((0, 1), (1, 0)):
        nodes, difference = np.unique(parts[mine]), ranks[mine] - ranks[other]
        share = 0.5 if difference == 0 else 1.0
        reach = np.full(len(nodes), guard if difference < 0 else dhat)
        total += node_face_sum(x, parts[other], nodes, share * area[nodes], reach)
    return total
