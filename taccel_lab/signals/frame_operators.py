# SPDX-License-Identifier: Apache-2.0
"""Operators that make frames of a camera faulty, by kind: kernels over batches, and each of them
for an image at hand.

Light is changed first (``frame_light_kernel``), then the frame as it comes over the wire
(``frame_wire_kernel``), with rows and frames that came before. Both do what the ``FrameFault`` of a
row says; a row without a fault keeps its bits.
"""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.guards import require_range, require_shape
from taccel_lab.signals.frame_faults import KINDS

wp.set_module_options({"enable_backward": False})

BITS = {kind: 1 << k for k, kind in enumerate(KINDS)}
LOST_ROWS = wp.constant(BITS["lost_rows"])
SHIFT = wp.constant(BITS["shift"])
TORN = wp.constant(BITS["torn"])
STUCK = wp.constant(BITS["stuck"])
DRIFT = wp.constant(BITS["drift"])
WEAR = wp.constant(BITS["wear"])
DEAD_LAMP = wp.constant(BITS["dead_lamp"])
BANDS = wp.constant(BITS["bands"])
DELAY = wp.constant(BITS["delay"])
GREY, GREEN = (128.0, 128.0, 128.0), (0.0, 135.0, 0.0)
"""Levels of rows that are lost: of a JPEG, and of zeros in YUV."""


@wp.struct
class FrameFault:
    """What is wrong with a frame; fields of other kinds than its own are 0."""

    kinds: wp.int32
    """Bits of ``KINDS``."""
    lost_from_row: wp.int32
    lost_level: wp.vec3
    shift_px: wp.int32
    """Positive to the right."""
    torn_from_row: wp.int32
    torn_px: wp.int32
    """Positive to the right; 0 for rows of the frame before."""
    stuck_frames: wp.int32
    """Number of times that the frame came before."""
    delay_frames: wp.int32
    wear_gain: wp.float32
    wear_across: wp.float32
    """Middle of the patch, -1 at the left edge to 1."""
    wear_down: wp.float32
    """The same from the upper edge."""
    wear_radius: wp.float32
    lamp_left: wp.vec3
    band_depth: wp.float32
    band_periods: wp.float32
    band_phase: wp.float32
    """Phase of the uppermost row, in periods."""
    drift_gain: wp.vec3
    """Change, as a part of the light."""
    drift_levels: wp.vec3
    drift_right: wp.vec3
    """Change from the middle to the right edge [levels]."""
    drift_down: wp.vec3
    """Change from the middle to the lower edge [levels]."""


LABEL = np.dtype(FrameFault.numpy_dtype())
FIELDS = [(name, LABEL[name]) for name in LABEL.names or ()]
"""Names and types of its fields, as ``FaultyFrames.labels`` has them."""


@wp.func
def part_across(place: int, count: int) -> float:
    """Place of a pixel among ``count``: -1 at the first to 1."""
    return 2.0 * float(place) / float(wp.max(count - 1, 1)) - 1.0


@wp.func
def drifted(
    level: float, gain: float, shift: float, right: float, lower: float, across: float, down: float
) -> float:
    """A level under light with a gain, a shift and a gradient [levels]."""
    level = gain * level + shift
    return level + across * right + down * lower


@wp.kernel
def frame_light_kernel(
    images: wp.array4d(dtype=wp.float32),
    faults: wp.array(dtype=FrameFault),
    seen: wp.array4d(dtype=wp.float32),
):
    """Levels under the light that each row's fault says, unclipped."""
    row, v, u, c = wp.tid()
    height, width = images.shape[1], images.shape[2]
    one = faults[row]
    level = images[row, v, u, c]
    across, down = part_across(u, width), part_across(v, height)
    if (one.kinds & WEAR) != 0:
        away = wp.vec2(across - one.wear_across, down - one.wear_down) / one.wear_radius
        level *= 1.0 + one.wear_gain * wp.exp(-0.5 * wp.dot(away, away))
    if (one.kinds & DEAD_LAMP) != 0:
        level *= one.lamp_left[c]
    if (one.kinds & BANDS) != 0:
        turn = one.band_periods * float(v) / float(height) + one.band_phase
        level *= 1.0 + one.band_depth * wp.sin(2.0 * wp.pi * turn)
    if (one.kinds & DRIFT) != 0:
        level = drifted(
            level, 1.0 + one.drift_gain[c], one.drift_levels[c], one.drift_right[c],
            one.drift_down[c], across, down,
        )  # fmt: skip
    seen[row, v, u, c] = level


@wp.kernel
def frame_wire_kernel(
    images: wp.array4d(dtype=Any),
    faults: wp.array(dtype=FrameFault),
    counts: wp.array(dtype=wp.int32),
    slots: int,
    keeps: bool,
    earlier: wp.array4d(dtype=Any),
    keeps_last: bool,
    last: wp.array4d(dtype=Any),
    seen: wp.array4d(dtype=Any),
):
    """Frames as they arrive.

    ``earlier`` holds those of ``slots`` calls before the wire, ``last`` those of two calls after
    it, row by row within a slot; ``counts`` are the calls since a row's episode began. Only slots
    of earlier calls are read.
    """
    row, v, u, c = wp.tid()
    rows, width = images.shape[0], images.shape[2]
    one, count = faults[row], counts[row]
    level = images[row, v, u, c]
    if keeps:
        earlier[count % slots * rows + row, v, u, c] = level
    if (one.kinds & STUCK) != 0:
        level = last[(count + 1) % 2 * rows + row, v, u, c]
    else:
        late, place = int(one.delay_frames), int(u - one.shift_px)
        if (one.kinds & TORN) != 0 and v >= one.torn_from_row:
            place -= one.torn_px
            if one.torn_px == 0:
                late += 1
        place = (place % width + width) % width
        if late > 0:
            level = earlier[(count - late) % slots * rows + row, v, place, c]
        else:
            level = images[row, v, place, c]
        if (one.kinds & LOST_ROWS) != 0 and v >= one.lost_from_row:
            level = images.dtype(one.lost_level[c])
    if keeps_last:
        last[count % 2 * rows + row, v, u, c] = level
    seen[row, v, u, c] = level


for _dtype in (wp.uint8, wp.float32):
    # All at once, as a module is compiled anew with each.
    _images = dict.fromkeys(("images", "earlier", "last", "seen"), wp.array4d(dtype=_dtype))
    wp.overload(frame_wire_kernel, _images)


# Operators of an image at hand ---------------------------------------------------------------


def lost_rows(image: np.ndarray, first_row: int, rgb: Sequence[float] = GREY) -> np.ndarray:
    """Return an image whose rows from ``first_row`` on are of one colour [levels].

    Here and below: ``image``, RGB levels [h, w, 3], is left as it is; the result has its type.

    Raises:
        InputError: Another shape, or a row that it does not have.
    """
    _require_row(image, "first_row", first_row)
    return _arrived(image, "lost_rows", lost_from_row=first_row, lost_level=wp.vec3(*rgb))


def shift(image: np.ndarray, px: int) -> np.ndarray:
    """Return an image whose rows are all moved ``px`` to the right, and go on at the left."""
    return _arrived(image, "shift", shift_px=px)


def torn(
    image: np.ndarray, first_row: int, *, px: int = 0, before: np.ndarray | None = None
) -> np.ndarray:
    """Return an image whose rows from ``first_row`` on are moved ``px`` to the right or are those
    of the frame ``before``.

    Raises:
        InputError: Not either of both, another shape, or a row that it does not have.
    """
    _require_row(image, "first_row", first_row)
    if (px == 0) == (before is None):
        raise InputError("torn needs either px, not 0, or the frame before")
    return _arrived(image, "torn", before, torn_from_row=first_row, torn_px=px)


def stuck(images: np.ndarray, first: int, frames: int = 1) -> np.ndarray:
    """Return frames [n, h, w, 3], of which those from ``first`` (at least 1) on are the one before
    it, ``frames`` times."""
    require_range("first", first, 1, len(images) - 1)
    shown = np.arange(len(images))
    shown[first : first + frames] = first - 1
    return images[shown]


def delay(images: np.ndarray, frames: int) -> np.ndarray:
    """Return frames [n, h, w, 3] that come ``frames`` late; the first one until then."""
    return images[np.maximum(np.arange(len(images)) - frames, 0)]


def drift(
    image: np.ndarray,
    gain: Sequence[float] = (1.0, 1.0, 1.0),
    levels: Sequence[float] = (0.0, 0.0, 0.0),
    right: Sequence[float] = (0.0, 0.0, 0.0),
    down: Sequence[float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """Return an image under other light: gain and offset of each channel, and what it gains
    [levels] from the middle to the right and to the lower edge."""
    changed = wp.vec3(*(factor - 1 for factor in gain))
    return _lit(
        image, "drift", drift_gain=changed, drift_levels=wp.vec3(*levels),
        drift_right=wp.vec3(*right), drift_down=wp.vec3(*down),
    )  # fmt: skip


def wear(
    image: np.ndarray, gain: float, middle: tuple[float, float] = (0.0, 0.0), radius: float = 0.25
) -> np.ndarray:
    """Return an image with a soft patch that is brighter by ``gain``, as a part of its light.

    Args:
        image: RGB levels, [h, w, 3].
        gain: In the middle.
        middle: Across and down, -1 at the left and upper edge to 1.
        radius: Standard deviation, as a part of half the image.
    """
    return _lit(
        image, "wear", wear_gain=gain, wear_across=middle[0], wear_down=middle[1],
        wear_radius=radius,
    )  # fmt: skip


def dead_lamp(image: np.ndarray, channel: int, left: float = 0.08) -> np.ndarray:
    """Return an image one of whose channels has the part ``left`` of its light."""
    require_range("channel", channel, 0, 2)
    return _lit(image, "dead_lamp", lamp_left=wp.vec3(*np.where(np.arange(3) == channel, left, 1)))


def bands(image: np.ndarray, depth: float, periods: float, phase: float = 0.0) -> np.ndarray:
    """Return an image whose rows are brighter by ``depth`` times a sine, as a part of their light:
    ``periods`` of it over the height, the first row at ``phase`` periods."""
    return _lit(image, "bands", band_depth=depth, band_periods=periods, band_phase=phase)


def _require_row(image: np.ndarray, name: str, row: int) -> None:
    require_shape("image", image, ("h", "w", 3))
    require_range(name, row, 0, len(image) - 1)


def _fault(kind: str, fields: dict[str, Any]) -> wp.array:
    one = FrameFault()
    one.kinds = BITS[kind]
    for name, value in fields.items():
        setattr(one, name, value)
    return wp.array([one], dtype=FrameFault, device="cpu")


def _lit(image: np.ndarray, kind: str, **fields: Any) -> np.ndarray:
    require_shape("image", image, ("h", "w", 3))
    given = wp.array(image[None].astype(np.float32), dtype=wp.float32, device="cpu")
    seen = wp.empty_like(given)
    wp.launch(frame_light_kernel, given.shape, [given, _fault(kind, fields)], [seen], device="cpu")
    found = seen.numpy()[0]
    return eight_bit(found) if image.dtype == np.uint8 else found.astype(image.dtype)


def _arrived(
    image: np.ndarray, kind: str, before: np.ndarray | None = None, **fields: Any
) -> np.ndarray:
    require_shape("image", image, ("h", "w", 3))
    frames = np.stack([image if before is None else before, image])
    frames = frames if image.dtype == np.uint8 else frames.astype(np.float32)
    kept, given = (wp.array(part, device="cpu") for part in (frames, frames[1:]))
    counts = wp.array([1], dtype=wp.int32, device="cpu")
    seen = wp.empty_like(given)
    wp.launch(
        frame_wire_kernel, given.shape,
        [given, _fault(kind, fields), counts, 2, False, kept, False, kept], [seen],
        device="cpu",
    )  # fmt: skip
    return seen.numpy()[0].astype(image.dtype)
