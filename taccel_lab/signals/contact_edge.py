# SPDX-License-Identifier: Apache-2.0
r"""Where contact ends, to well below an element.

Just outside a smooth contact the gap opens as ``g = C d^(3/2)`` with the distance d to the edge
(K. L. Johnson, Contact Mechanics, 1985, section 4.2), so ``s = g^(2/3)`` is linear in d. The nodes
in contact know nothing about the edge (their gap is zero); they get the value that extrapolates s
from the open nodes beside them. The edge is then the zero contour of the C1 interpolant of s, and
the gap outside is ``max(s, 0)^(3/2)``: smooth on both sides of the edge, no ripple.

With friction the gap opens slower at first and the extrapolation would put the edge far inside the
contact. Hence it is bounded: a node in contact is inside, the deeper the more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.signals.contact_surface import ContactSurface

# Layers of contact nodes beside the edge whose s is extrapolated. The interpolant at the edge
# looks at patches two rings wide, on either side of the element that holds the edge.
_EXTRAPOLATED_LAYERS = 4
# Relative weight of "s has no curvature" in the extrapolation. Of 0.01, 0.03 and 0.1 this gave the
# roundest edge on simulated presses; the contact radius of exact data is 0.01 mm small with it.
_CURVATURE_RIDGE = 0.03
# A node in contact lies inside the edge by at least this part of its way to the nodes at the edge,
# and by at most the other: along a prism elements are many times as long as across it.
_LEAST_WAY, _MOST_WAY = 0.5, 1.5


@dataclass(frozen=True)
class EdgeField:
    """Signed edge field of one environment."""

    s: np.ndarray
    """Extended g^(2/3) [m^(2/3)] at the surface nodes, negative in contact, shape [node]."""
    growth: float
    """Typical |grad s| at the edge [m^(-1/3)]: s / growth is the distance to the edge [m]."""
    element_m: float
    """Typical length of the edges that leave the contact [m], in projection."""


def edge_field(surface: ContactSurface, xy: np.ndarray, gap: np.ndarray) -> EdgeField | None:
    """Extended edge field of one environment, or None without contact.

    Args:
        surface: Contact triangulation.
        xy: Node positions [m], shape [node, 2].
        gap: Gap beyond the barrier's own [m], shape [node]: zero in contact, NaN where the object
            is not above the node.
    """
    touching = gap <= 0.0
    leaving = surface.edges[touching[surface.edges].sum(axis=1) == 1]
    if len(leaving) == 0:
        return None
    element_m = float(np.median(np.linalg.norm(xy[leaving[:, 0]] - xy[leaving[:, 1]], axis=1)))
    s = np.where(gap > 0.0, np.maximum(gap, 0.0) ** (2.0 / 3.0), np.nan)
    found = _extrapolate(surface, xy, s, ~np.isnan(s))
    if not found:
        # A stamp that touches up to its silhouette has no open node and no edge inside it.
        return EdgeField(np.full(len(s), -element_m), 1.0, element_m)
    growth = float(np.median([slope for _, _, slope in found]))
    for node, value, _ in found:
        # Free beside the object: a stamp that touches up to its silhouette has its edge there.
        s[node] = min(value, 0.0) if touching[node] else value
    at_edge = np.isin(np.arange(len(s)), [node for node, _, _ in found])
    way = _shortest_ways(surface, xy, np.where(at_edge, 0.0, np.nan))
    for _ in range(1, _EXTRAPOLATED_LAYERS):
        for node, value, _ in _extrapolate(surface, xy, s, ~np.isnan(s)):
            most, least = (-share * way[node] * growth for share in (_LEAST_WAY, _MOST_WAY))
            s[node] = min(max(value, least - element_m * growth), most) if touching[node] else value
    # Deeper in only the sign counts, and that nothing is steep: the interpolant would swing.
    behind = np.where(s <= 0.0, -s / growth, np.nan)
    inside = -growth * _shortest_ways(surface, xy, behind)
    return EdgeField(np.where(np.isnan(s), inside, s), growth, element_m)


def _shortest_ways(surface: ContactSurface, xy: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Shortest way along edges to each node [m], from those whose ``start`` is no NaN, with that
    (0 or more) as the way that they have behind them; the longest for what is not connected. All of
    shape [node]."""
    from scipy import sparse

    count = len(start)
    known = np.flatnonzero(~np.isnan(start))
    a, b = surface.edges.T
    length = np.linalg.norm(xy[a] - xy[b], axis=1)
    # One more node, from which all that are known are reached; a way of zero would be no edge.
    rows = np.concatenate([a, np.full(len(known), count)])
    columns = np.concatenate([b, known])
    weights = np.concatenate([length, start[known]]) + 1e-12
    graph = sparse.coo_array((weights, (rows, columns)), shape=(count + 1, count + 1)).tocsr()
    way = sparse.csgraph.dijkstra(graph, directed=False, indices=count)[:count]
    return np.where(np.isfinite(way), way, way[np.isfinite(way)].max())


def _extrapolate(
    surface: ContactSurface, xy: np.ndarray, s: np.ndarray, known: np.ndarray
) -> list[tuple[int, float, float]]:
    """(node, extrapolated s, its slope) for the unknown nodes beside known ones.

    A quadratic patch fit with weights 1/distance. s bends little, and a curvature fitted to a few
    nodes on one side amplifies their noise, hence a ridge on the quadratic terms.
    """
    found: list[tuple[int, float, float]] = []
    beside = np.zeros(len(s), dtype=bool)
    first, second = surface.edges.T
    beside[first[known[second]]] = True
    beside[second[known[first]]] = True
    for node in np.flatnonzero(beside & ~known):
        patch = surface.patch_nodes[surface.patch_start[node] : surface.patch_start[node + 1]]
        patch = patch[known[patch]]
        if len(patch) < 4:
            continue
        offset = xy[patch] - xy[node]
        distance = np.linalg.norm(offset, axis=1)
        reach = distance.max()
        x, y = (offset / reach).T
        weight = reach / distance
        design = np.zeros((len(patch) + 3, 6))
        design[:-3] = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        design[:-3] *= weight[:, None]
        design[-3:, 3:] = np.eye(3) * (_CURVATURE_RIDGE * np.linalg.norm(weight))
        target = np.concatenate([s[patch] * weight, np.zeros(3)])
        fit = np.linalg.lstsq(design, target, rcond=None)[0]
        found.append((int(node), float(fit[0]), float(np.hypot(fit[1], fit[2]) / reach)))
    return found
