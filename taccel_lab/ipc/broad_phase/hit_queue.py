# SPDX-License-Identifier: Apache-2.0
"""Hits of tree queries, gathered by the lanes of a warp until there is one for each of them.

Some queries hit nothing and others two hundred boxes, and what is done with a hit costs more than
to find it. Done at once, by the lane that found it, most lanes wait: the search of 256 nuts on
their bolts took an H200 7.6 ms, 1.9 of them in the trees, and takes 2.9 with a queue. On the CPU
each hit is due at once.

All lanes of a warp come to each call: one without a query says so. A kernel over (environment,
lane) with a multiple of 32 lanes has warps of one environment.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native

wp.set_module_options({"enable_backward": False})


@wp.func_native(native("hit_queue", "batch"))
def batch() -> int:
    """Hits that are worth taking: one for each lane of the warp."""
    ...


@wp.func_native(native("hit_queue", "open_queue"))
def open_queue() -> wp.uint64:
    """Queue of a warp."""
    ...


@wp.func_native(native("hit_queue", "any_lane"))
def any_lane(value: bool) -> bool:
    """Whether it is so in any lane of the warp."""
    ...


@wp.func_native(native("hit_queue", "put_hit"))
def put_hit(queue: wp.uint64, waiting: int, item: int, hit: int) -> int:
    """Add (item, hit) of each lane whose ``hit`` is not negative to the ``waiting`` ones, less than
    ``batch()``; returns how many wait now."""
    ...


@wp.func_native(native("hit_queue", "hit_at"))
def hit_at(queue: wp.uint64, first: int, end: int) -> wp.vec2i:
    """The lane's own of the hits ``first`` to ``end``; (-1, -1) when there are fewer."""
    ...
