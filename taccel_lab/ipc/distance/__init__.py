# SPDX-License-Identifier: Apache-2.0
"""Distances between points, edges and triangles with exact first and second derivatives."""

from taccel_lab.ipc.distance.closest_pair import ClosestPair, combine
from taccel_lab.ipc.distance.derivatives import (
    PairFrame,
    distance_gradient,
    distance_sq_gradient,
    distance_sq_hessian,
    pair_frame,
    pair_normal,
)
from taccel_lab.ipc.distance.edge_edge import (
    EdgeEdgeRegion,
    closest_edge_edge,
    edge_edge_distance_sq,
)
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_mollifier,
    edge_edge_mollifier_gradient,
    edge_edge_mollifier_hessian,
    edge_edge_mollifier_threshold,
)
from taccel_lab.ipc.distance.point_edge import (
    PointEdgeRegion,
    closest_point_edge,
    point_edge_distance_sq,
)
from taccel_lab.ipc.distance.point_point import closest_point_point, point_point_distance_sq
from taccel_lab.ipc.distance.point_triangle import (
    PointTriangleRegion,
    closest_point_triangle,
    point_triangle_distance_sq,
)

__all__ = [
    "ClosestPair",
    "EdgeEdgeRegion",
    "PairFrame",
    "PointEdgeRegion",
    "PointTriangleRegion",
    "closest_edge_edge",
    "closest_point_edge",
    "closest_point_point",
    "closest_point_triangle",
    "combine",
    "distance_gradient",
    "distance_sq_gradient",
    "distance_sq_hessian",
    "edge_edge_cross_sq",
    "edge_edge_distance_sq",
    "edge_edge_mollifier",
    "edge_edge_mollifier_gradient",
    "edge_edge_mollifier_hessian",
    "edge_edge_mollifier_threshold",
    "pair_frame",
    "pair_normal",
    "point_edge_distance_sq",
    "point_point_distance_sq",
    "point_triangle_distance_sq",
]
