# SPDX-License-Identifier: Apache-2.0
"""Boxes around what moves: of single primitives, of whole bodies.

They are FP32, rounded outwards, around straight paths, in the world or in the frame of a body.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.ragged_lists import ListRoom, claim_place
from taccel_lab.ipc.device.sums import BLOCK_THREADS
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


@wp.struct
class SweptBox:
    """An FP32 box, rounded outwards."""

    lower: wp.vec3
    upper: wp.vec3


@wp.struct
class BodyFrame:
    """An affine map body_from_world, x -> inverse (x - origin) [m]."""

    inverse: wp.mat33d
    origin: wp.vec3d


@wp.struct
class Frames:
    """Frames of all stiff bodies at both ends of a motion, [env_count, frame_count].

    bends: what ``bend_of`` says of the way between.
    """

    starts: wp.array2d(dtype=BodyFrame)
    ends: wp.array2d(dtype=BodyFrame)
    bends: wp.array2d(dtype=wp.vec3d)


@wp.func
def into_frame(frame: BodyFrame, x: wp.vec3d) -> wp.vec3d:
    """A world point in the frame of a body [m]."""
    return frame.inverse * (x - frame.origin)


@wp.func
def include(
    low: wp.vec3d,
    high: wp.vec3d,
    travel: wp.float64,
    x: wp.vec3d,
    displacement: wp.vec3d,
    start: BodyFrame,
    end: BodyFrame,
):
    """Grow a box by both ends of a node's path, in the body frame, and the longest way between."""
    a = into_frame(start, x)
    b = into_frame(end, x + displacement)
    low = wp.min(low, wp.min(a, b))
    high = wp.max(high, wp.max(a, b))
    return low, high, wp.max(travel, wp.length(b - a))


@wp.func
def frobenius(m: wp.mat33d) -> wp.float64:
    """Frobenius norm."""
    return wp.sqrt(wp.ddot(m, m))


@wp.func
def bend_of(start: BodyFrame, end: BodyFrame) -> wp.vec3d:
    """|A0^-1|, |E| and s of ``widened_margin``, of a body that moves from one frame to another."""
    one = wp.float64(1.0)
    unit = wp.identity(n=3, dtype=wp.float64)
    stretch = wp.sqrt(one + frobenius(wp.transpose(start.inverse) * start.inverse - unit))
    change = start.inverse * wp.inverse(end.inverse) - unit
    least = one - frobenius(wp.float64(0.5) * (change + wp.transpose(change)))
    return wp.vec3d(stretch, frobenius(change), least)


@wp.func
def widened_margin(margin: wp.float64, travel: wp.float64, bend: wp.vec3d) -> wp.float64:
    """Margin in the frame of a body that turns or stretches: straight paths are bent there.

    Let a node be at w0 at the start and at w1 at the end in the body frame, and its offset from a
    point of the body on the way be, in the frame of the start, a + M b with a = (1 - t) w0,
    b = t w1 and M = A0^-1 A1 = I + E. The box knows a + b. If |a + M b| <= m, then
    |a + b| <= m + |E| |b|, and as ((1 - t) / t + M) b = (a + M b) + (1 - t) (w1 - w0), with
    D = |w1 - w0| and s > 0 the least eigenvalue of M's symmetric part, |b| <= (m + D / 4) / s.
    The margin m itself grows by |A0^-1|. Own derivation.
    """
    if bend[2] < wp.float64(0.05):
        # A turn by more than 80 degrees: no bound, everything is a candidate.
        return wp.float64(1.0e20)
    m = margin * bend[0]
    return m + bend[1] * (m + wp.float64(0.25) * travel) / bend[2]


@wp.func
def rounded_out(low: wp.vec3d, high: wp.vec3d, margin: wp.float64) -> SweptBox:
    """FP32 box that holds [low - margin, high + margin] whatever the rounding."""
    box = SweptBox()
    for k in range(3):
        a = low[k] - margin
        b = high[k] + margin
        # One FP32 rounding is at most 6e-8 of the value; twice that is safe.
        slack = wp.float64(1.2e-7)
        box.lower[k] = wp.float32(a - slack * wp.abs(a))
        box.upper[k] = wp.float32(b + slack * wp.abs(b))
    return box


@wp.func
def append(env: int, a: int, b: int, room: ListRoom, pairs: wp.array(dtype=wp.vec2i)):
    """Append a pair; counts beyond the room tell the host to grow and repeat."""
    at = claim_place(env, room)
    if at >= 0:
        pairs[at] = wp.vec2i(a, b)


@wp.func
def _least(value: wp.float64) -> wp.float64:
    return wp.tile_extract(wp.tile_min(wp.tile(value)), 0)


@wp.func
def _largest(value: wp.float64) -> wp.float64:
    return wp.tile_extract(wp.tile_max(wp.tile(value)), 0)


@wp.kernel
def _body_boxes_kernel(
    mask: Envs,
    body_nodes: wp.array(dtype=wp.vec2i),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    lower: wp.array2d(dtype=wp.vec3d),
    upper: wp.array2d(dtype=wp.vec3d),
):
    place, body, lane = wp.tid()
    env = env_at(place, mask)
    if env < 0:
        return
    big = wp.float64(1.0e30)
    low = wp.vec3d(big, big, big)
    high = -low
    for node in range(body_nodes[body][0] + lane, body_nodes[body][1], wp.block_dim()):
        x = positions[env, node]
        low = wp.min(low, x)
        high = wp.max(high, x)
        if displacements:
            end = x + displacements[env, node]
            low = wp.min(low, end)
            high = wp.max(high, end)
    low = wp.vec3d(_least(low[0]), _least(low[1]), _least(low[2]))
    high = wp.vec3d(_largest(high[0]), _largest(high[1]), _largest(high[2]))
    if lane == 0:
        lower[env, body] = low
        upper[env, body] = high


def find_body_boxes(
    mask: EnvMask,
    body_nodes: wp.array,
    positions: wp.array,
    displacements: wp.array | None,
    lower: wp.array,
    upper: wp.array,
) -> None:
    """Corners of a box around each body [m], [env_count, body_count], by a thread block each.

    ``body_nodes``: range of the nodes of each body, vec2i, [body_count]; ``displacements``:
    straight ways that the boxes hold, too.
    """
    inputs = [mask, body_nodes, positions, displacements, lower, upper]
    launch_blocks(_body_boxes_kernel, lower.shape, *inputs)
