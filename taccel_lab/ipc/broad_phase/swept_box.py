# SPDX-License-Identifier: Apache-2.0
"""FP32 boxes, rounded outwards, around straight paths, in the world or in the frame of a body."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class SweptBox:
    """An FP32 box, rounded outwards."""

    lower: wp.vec3
    upper: wp.vec3


@wp.struct
class Frames:
    """Affine maps body_from_world of all stiff bodies: x -> inverse (x - origin).

    inverses: mat33d, origins [m]: vec3d, [env_count, frame_count].
    """

    inverses: wp.array2d(dtype=wp.mat33d)
    origins: wp.array2d(dtype=wp.vec3d)


@wp.func
def into_frame(frames: Frames, env: int, frame: int, x: wp.vec3d) -> wp.vec3d:
    """A world point in the frame of a body [m]."""
    return frames.inverses[env, frame] * (x - frames.origins[env, frame])


@wp.func
def include(
    low: wp.vec3d,
    high: wp.vec3d,
    travel: wp.float64,
    env: int,
    frame: int,
    node: int,
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    start: Frames,
    end: Frames,
):
    """Grow a box by both ends of a node's path, in the body frame, and the longest way between."""
    x = positions[env, node]
    a = into_frame(start, env, frame, x)
    b = into_frame(end, env, frame, x + displacements[env, node])
    low = wp.min(low, wp.min(a, b))
    high = wp.max(high, wp.max(a, b))
    return low, high, wp.max(travel, wp.length(b - a))


@wp.func
def frobenius(m: wp.mat33d) -> wp.float64:
    """Frobenius norm."""
    return wp.sqrt(wp.ddot(m, m))


@wp.func
def widened_margin(
    margin: wp.float64, travel: wp.float64, env: int, frame: int, start: Frames, end: Frames
) -> wp.float64:
    """Margin in the frame of a body that turns or stretches: straight paths are bent there.

    Let a node be at w0 at the start and at w1 at the end in the body frame, and its offset from a
    point of the body on the way be, in the frame of the start, a + M b with a = (1 - t) w0,
    b = t w1 and M = A0^-1 A1 = I + E. The box knows a + b. If |a + M b| <= m, then
    |a + b| <= m + |E| |b|, and as ((1 - t) / t + M) b = (a + M b) + (1 - t) (w1 - w0), with
    D = |w1 - w0| and s > 0 the least eigenvalue of M's symmetric part, |b| <= (m + D / 4) / s.
    The margin m itself grows by |A0^-1|. Own derivation.
    """
    one = wp.float64(1.0)
    unit = wp.identity(n=3, dtype=wp.float64)
    inverse = start.inverses[env, frame]
    stretch = wp.sqrt(one + frobenius(wp.transpose(inverse) * inverse - unit))
    change = inverse * wp.inverse(end.inverses[env, frame]) - unit
    least = one - frobenius(wp.float64(0.5) * (change + wp.transpose(change)))
    if least < wp.float64(0.05):
        # A turn by more than 80 degrees: no bound, everything is a candidate.
        return wp.float64(1.0e20)
    m = margin * stretch
    return m + frobenius(change) * (m + wp.float64(0.25) * travel) / least


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
def append(
    env: int,
    a: int,
    b: int,
    counts: wp.array(dtype=wp.int32),
    pairs: wp.array2d(dtype=wp.vec2i),
):
    """Append a pair; counts beyond the capacity tell the host to grow and repeat."""
    slot = wp.atomic_add(counts, env, 1)
    if slot < pairs.shape[1]:
        pairs[env, slot] = wp.vec2i(a, b)
