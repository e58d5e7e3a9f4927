# SPDX-License-Identifier: Apache-2.0
"""Pairs of overlapping boxes, found with a search tree: the first sieve of all checks of meshes."""

from __future__ import annotations

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _pairs_kernel(
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    starts: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array(dtype=wp.vec2i),
):
    i = wp.tid()
    query = wp.bvh_query_aabb(tree, lowers[i], uppers[i])
    found = int(0)
    other = int(0)
    while wp.bvh_query_next(query, other):
        if pairs:
            pairs[starts[i] + found] = wp.vec2i(i, other)
        found += 1
    if counts:
        counts[i] = found


def box_pairs(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the boxes of two sets that overlap, each box pair once.

    ``first``, ``second``: lower and upper corners, each [n, 3]. Boxes are rounded outwards to FP32,
    so pairs may lie apart by a rounding error, but none that overlaps is missed. Runs on Warp's
    default device: the GPU where there is one.
    """
    empty = np.zeros(0, dtype=np.int64)
    if len(first[0]) == 0 or len(second[0]) == 0:
        return empty, empty
    # About a common centre FP32 keeps seven digits of the extent, wherever the bodies are.
    origin = 0.5 * (second[0].min(axis=0) + second[1].max(axis=0))
    lower_a, upper_a = _outward(first, origin)
    lower_b, upper_b = _outward(second, origin)
    tree = wp.Bvh(lower_b, upper_b)
    counts = wp.zeros(len(first[0]), dtype=wp.int32)
    _launch(tree, lower_a, upper_a, None, counts, None)
    found = counts.numpy()
    starts = wp.array(np.cumsum(found) - found, dtype=wp.int32)
    pairs = wp.zeros(max(int(found.sum()), 1), dtype=wp.vec2i)
    _launch(tree, lower_a, upper_a, starts, None, pairs)
    result = pairs.numpy()[: int(found.sum())].astype(np.int64)
    return result[:, 0], result[:, 1]


def _outward(boxes: tuple[np.ndarray, np.ndarray], origin: np.ndarray) -> tuple[wp.array, wp.array]:
    lower = np.nextafter((boxes[0] - origin).astype(np.float32), np.float32(-np.inf))
    upper = np.nextafter((boxes[1] - origin).astype(np.float32), np.float32(np.inf))
    return (
        wp.array(lower, dtype=wp.vec3),
        wp.array(upper, dtype=wp.vec3),
    )


def _launch(
    tree: wp.Bvh,
    lower: wp.array,
    upper: wp.array,
    starts: wp.array | None,
    counts: wp.array | None,
    pairs: wp.array | None,
) -> None:
    wp.launch(
        _pairs_kernel,
        dim=lower.shape,
        inputs=[tree.id, lower, upper, starts],
        outputs=[counts, pairs],
    )
