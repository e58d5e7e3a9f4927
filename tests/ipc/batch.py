# SPDX-License-Identifier: Apache-2.0
"""Warp functions over batches of numpy arrays, and stencils of four nodes to call them with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import warp as wp
from hypothesis import strategies as st

from taccel_lab.ipc.distance import ccd, closest_pairs

Array = np.ndarray[Any, np.dtype[Any]]
NODE_COUNTS = {"point_triangle": 4, "edge_edge": 4, "point_edge": 3, "point_point": 2}
POINT_TRIANGLE, EDGE_EDGE, POINT_EDGE, POINT_POINT = range(4)
PLANE = 2
"""For ``collide``: point, point of the plane, its normal."""


def mapped(func: Any, *inputs: Any) -> Any:
    """What a Warp function returns for each row of its inputs; numbers are the same for all."""
    module = wp.get_module(f"map_{func.key}")
    if module.options["enable_backward"]:
        wp.set_module_options({"enable_backward": False}, module=module)
    kinds = func.input_types.values()
    given = [
        wp.array(value, dtype=kind, device="cpu") if isinstance(value, np.ndarray) else kind(value)
        for value, kind in zip(inputs, kinds, strict=True)
    ]
    found = wp.map(func, *given)
    return [array.numpy() for array in found] if isinstance(found, list) else found.numpy()


@wp.func
def closest(
    kind: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d
) -> closest_pairs.ClosestPair:
    if kind == 0:
        return closest_pairs.closest_point_triangle(x0, x1, x2, x3)
    if kind == 1:
        return closest_pairs.closest_edge_edge(x0, x1, x2, x3)
    if kind == 2:
        return closest_pairs.closest_point_edge(x0, x1, x2)
    return closest_pairs.closest_point_point(x0, x1)


@wp.func
def _query(kind: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d):
    pair = closest(kind, x0, x1, x2, x3)
    only = wp.length_sq(x0 - x1)
    if kind == 0:
        only = closest_pairs.point_triangle_distance_sq(x0, x1, x2, x3)
    elif kind == 1:
        only = closest_pairs.edge_edge_distance_sq(x0, x1, x2, x3)
    elif kind == 2:
        only = closest_pairs.point_edge_distance_sq(x0, x1, x2)
    return pair.region, pair.weights, pair.distance_sq, only


@wp.func
def _collide(
    kind: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d,
    v0: wp.vec3d, v1: wp.vec3d, v2: wp.vec3d, v3: wp.vec3d,
    thickness: wp.float64, slackness: wp.float64, t_max: wp.float64, most: wp.int32,
):  # fmt: skip
    found = ccd.CCDResult()
    if kind == 0:
        found = ccd.point_triangle_ccd(
            x0, x1, x2, x3, v0, v1, v2, v3, thickness, slackness, t_max, most
        )
    elif kind == 1:
        found = ccd.edge_edge_ccd(x0, x1, x2, x3, v0, v1, v2, v3, thickness, slackness, t_max, most)
    else:
        found = ccd.point_plane_ccd(x0, x1, x2, v0, v1, thickness, slackness, t_max)
    return found.toi, found.status, found.iterations


class Pairs(NamedTuple):
    region: Array
    weights: Array
    distance_sq: Array
    distance_sq_only: Array


def filled(values: Any, count: int) -> Array:
    return np.full(count, values, dtype=float)


def query_pairs(kind: int, x: Array) -> Pairs:
    return Pairs(*mapped(_query, kind, *x.swapaxes(0, 1)))


def collide(
    kind: int,
    x: Array,
    dx: Array,
    thickness: Any = 0.0,
    slackness: float = 0.1,
    t_max: float = 1.0,
    max_iterations: int = 1000,
) -> list[Array]:
    nodes = [*x.swapaxes(0, 1), *dx.swapaxes(0, 1)]
    kept = filled(thickness, len(x))
    return mapped(_collide, kind, *nodes, kept, slackness, t_max, max_iterations)


def unit(v: Array) -> Array:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def random_stencils(seed: int, count: int) -> Array:
    """Standard normal nodes, shape [count, 4, 3]; every region of both queries occurs."""
    return np.random.default_rng(seed).normal(size=(count, 4, 3))


def nearly_parallel_edges(
    seed: int, count: int, angle_exponents: tuple[float, float] = (-9.0, -1.0)
) -> Array:
    """Edges of length about 1 with log-uniform angles [rad], and gaps log-uniform in 1e-4 .. 1."""
    rng = np.random.default_rng(seed)
    direction = unit(rng.normal(size=(count, 3)))
    across = unit(np.cross(direction, rng.normal(size=(count, 3))))
    normal = np.cross(direction, across)
    angle = 10.0 ** rng.uniform(*angle_exponents, size=(count, 1))
    gap = 10.0 ** rng.uniform(-4, 0, size=(count, 1))
    start = rng.normal(size=(count, 3))
    shift = rng.uniform(-0.8, 0.8, size=(count, 1))
    eb0 = start + shift * direction - angle * rng.uniform(0, 1, (count, 1)) * across + gap * normal
    return np.stack([start, start + direction, eb0, eb0 + direction + angle * across], axis=1)


@st.composite
def degenerate_stencils(draw: st.DrawFn) -> Array:
    """Nodes on a coarse grid, often coincident or coplanar, scaled, shifted, and nudged by ulps."""
    nodes = np.array(draw(st.lists(st.integers(-2, 2), min_size=12, max_size=12)), dtype=np.float64)
    stencil = nodes.reshape(4, 3) * 10.0 ** draw(st.integers(-7, 2))
    stencil = stencil + draw(st.sampled_from([0.0, 0.0, 0.5, 1024.0]))
    if draw(st.booleans()):
        nudges = draw(st.lists(st.integers(-3, 3), min_size=12, max_size=12))
        stencil = stencil + np.array(nudges).reshape(4, 3) * np.spacing(np.abs(stencil))
    return stencil
