# SPDX-License-Identifier: Apache-2.0
"""What elements add to the matrix through bonded nodes that an affine body carries.

Such a node b is x_b = sum_k w_k(b) y_k of the four control nodes of its body, so a part H_ba of an
element's matrix counts as w_k(b) H_ba between y_k and a free node a, and a part H_bc between two
such nodes as w_i(b) w_j(c) H_bc between y_i and y_j: unknowns are left out, none are added, and no
spring stands for the bond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.model.matrix_pattern import BlockPattern
from taccel_lab.model.surface import Put


@dataclass(frozen=True)
class CarriedBlocks:
    """Where the parts of one group of elements go that hold carried nodes, in a fixed order."""

    targets: wp.array
    """Blocks of the pattern between the control nodes of a body and a free node, vec4i, shape
    [couple_count]."""
    starts: wp.array
    """Range of each couple in the next two, int32, shape [couple_count + 1]."""
    sources: wp.array
    """Parts d^2E / dx_carried dx_free as 2 part + transposed, int32."""
    nodes: wp.array
    """The carried node of each, int32."""
    corners: wp.array
    """Block of y0 with itself of each body that carries nodes of the group, and those of the next
    three control nodes, vec4i, shape [body_count]."""
    own_starts: wp.array
    """Range of each body in the next two, int32, shape [body_count + 1]."""
    own_parts: wp.array
    """Parts between two carried nodes, int32."""
    own_nodes: wp.array
    """Their nodes, vec2i."""


def carried_blocks(
    pattern: BlockPattern,
    first: np.ndarray,
    second: np.ndarray,
    free_index: np.ndarray,
    parents: np.ndarray,
    put: Put,
) -> CarriedBlocks | None:
    """Carried blocks of parts d^2E / dx_first dx_second, both int, shape [part_count]; None without
    carried nodes.

    ``free_index``, ``parents``: row of each node or -1, and first control node of the body that
    carries it or -1, shape [node_count].
    """
    carried = parents >= 0
    own = np.flatnonzero(carried[first] & carried[second])
    if len(own) == 0:
        return None
    turned = carried[second]
    node = np.where(turned, second, first)
    free = np.where(turned, first, second)
    mixed = np.flatnonzero(carried[node] & (free_index[free] >= 0))
    parent, row = parents[node[mixed]].astype(np.int64), free_index[free[mixed]].astype(np.int64)
    count = pattern.free_count
    order = np.argsort(parent * count + row, kind="stable")
    keys, starts = np.unique((parent * count + row)[order], return_index=True)
    control = free_index[keys // count][:, None] + np.arange(4)
    stored = pattern.rows.astype(np.int64) * count + pattern.columns
    targets = np.searchsorted(stored, control * count + keys[:, None] % count)
    mixed = mixed[order]
    own = own[np.argsort(parents[first[own]], kind="stable")]
    bodies, own_starts = np.unique(parents[first[own]], return_index=True)
    corners = pattern.diagonal[free_index[bodies][:, None] + np.arange(4)]
    return CarriedBlocks(
        targets=put(targets, wp.vec4i),
        starts=put(np.append(starts, len(mixed)), wp.int32),
        sources=put(2 * mixed + turned[mixed], wp.int32),
        nodes=put(node[mixed], wp.int32),
        corners=put(corners, wp.vec4i),
        own_starts=put(np.append(own_starts, len(own)), wp.int32),
        own_parts=put(own, wp.int32),
        own_nodes=put(np.column_stack([first[own], second[own]]), wp.vec2i),
    )
