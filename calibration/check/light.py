# SPDX-License-Identifier: Apache-2.0
"""Findings about light: drift, saturation, channel order, and another sensor's frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.framing import best_channel_order
from taccel_lab.calibration.capture.sensor_facts import handedness
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.circles.color_change import SUNK_RADII
from taccel_lab.calibration.circles.contact_finder import MOSTLY
from taccel_lab.calibration.light_drift import drift_remarks
from taccel_lab.calibration.remarks import name_some
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.thumb import thumb
from taccel_lab.report.remark import Remark

SATURATED_SHARE, VERY_SATURATED_SHARE = 0.05, 0.3
SWAP_MIN_LEVELS, SWAP_RATIO = 6.0, 1.6
"""A frame's channels are swapped when another order fits this much better. Real sets: 2.3 and more
with red and blue swapped, 1.0 without."""
SWAP_NEAR = 3.0
"""How much farther from the background than most frames a swapped one may be when it is put right.
"""
GREY_PICTURE_SHARE, GREY_CONTACT_SHARE = 0.03, 0.2
"""Colours across the commonest one relative to those along it, at most, under white light: of the
pixels of whole pictures (two real 9DTacts 0.009 to 0.012, 15 real sensors with coloured lamps 0.07
to 0.27), and of what contacts change most."""
MIXED_MIN_LEVELS, MIXED_RATIO = 5.0, 2.0
"""Two groups of frames are of different sensors when they differ by this much, and this many times
as much as the frames of the tighter group among themselves."""
MIN_MIXED = 4
PAIR_THUMB_PX = 48
MAX_PAIRED = 60
HANDED = 0.7
CHANNELS = "RGB"


def check_light(
    frames: Sequence[FrameFigures], background: np.ndarray, grid: PixelGrid
) -> list[Remark]:
    """All findings of this module that need presses on a grid and a background (small, RGB
    levels)."""
    swapped = check_channel_order(frames, background)
    if swapped:  # Drift and other sensors would be found as a consequence.
        return [*swapped, *_check_saturation(frames)]
    return [
        *_check_drift(frames, background),
        *_check_saturation(frames),
        *check_mixed(frames, grid),
    ]


def is_grey(frames: Sequence[FrameFigures], background: np.ndarray) -> bool | None:
    """Whether the pictures are those of white light: pixels of one colour, brighter or darker, in
    the untouched gel and in the presses, and contacts that change all channels alike. None where
    nothing has a colour and there is no contact to say more.

    ``background``: small, RGB levels.
    """
    pictures = [background, *(frame.thumb for frame in frames)]
    if np.median([_across(picture) for picture in pictures]) >= GREY_PICTURE_SHARE:
        return False
    strongest = []
    for frame in frames:
        if frame.circle is None:
            continue
        change = frame.thumb - frame.reference
        size = np.linalg.norm(change, axis=-1)
        strongest.append(change[size >= np.percentile(size, 97)])
    if not strongest:
        return None
    return _across(np.concatenate(strongest)) < GREY_CONTACT_SHARE


def _across(colors: np.ndarray) -> float:
    """What there is of ``colors`` [..., 3] across their commonest direction, over what is along."""
    along, across, _ = np.linalg.svd(colors.reshape(-1, 3), compute_uv=False)
    return float(across / max(along, 1e-9))


def _check_drift(frames: Sequence[FrameFigures], background: np.ndarray) -> list[Remark]:
    if len(frames) < 2:
        return []
    found = drift_remarks([frame.light for frame in frames], background)
    return [replace(remark, blocks=("color", "normals", "depth")) for remark in found]


def _check_saturation(frames: Sequence[FrameFigures]) -> list[Remark]:
    shares = np.array([frame.saturated_share for frame in frames])
    bad = np.flatnonzero(shares > SATURATED_SHARE)
    if len(bad) < max(1, 0.1 * len(frames)):
        return []
    worst = bad[np.argsort(-shares[bad])]
    names = [frames[i].press.name for i in worst]
    return [
        remarks.SATURATED(
            bad=len(bad),
            count=len(frames),
            limit=SATURATED_SHARE,
            largest=shares.max(),
            frames=names,
            grave=bool(np.median(shares) > VERY_SATURATED_SHARE),
        )
    ]


def check_channel_order(frames: Sequence[FrameFigures], background: np.ndarray) -> list[Remark]:
    """Channels that are swapped in some frames, or between the frames and the background."""
    orders = [best_channel_order(frame.thumb, background) for frame in frames]
    if not orders:
        return []
    # Put right, a frame is as near to the background as the others are; a turned picture is not.
    near = max(SWAP_MIN_LEVELS, float(np.percentile([best for _, best, _ in orders], 25)))
    swapped = [
        i
        for i, (order, best, asis) in enumerate(orders)
        if order != (0, 1, 2)
        and asis > SWAP_MIN_LEVELS
        and asis > SWAP_RATIO * best
        and best < SWAP_NEAR * near
    ]
    if not swapped:
        return []
    order = "".join(CHANNELS[c] for c in orders[swapped[0]][0])
    names = [frames[i].press.name for i in swapped]
    _, best, asis = orders[swapped[0]]
    if len(swapped) > 0.5 * len(frames):
        what = f"{len(swapped)} of {len(frames)} presses and the background"
    else:
        what = f"{name_some(names)} and the other images"
    return [remarks.CHANNELS_SWAPPED(what=what, order=order, best=best, as_is=asis, frames=names)]


def check_handedness(
    frames: Sequence[FrameFigures],
    background: np.ndarray,
    family: str,
    expected: float | None,
) -> list[Remark]:
    """Channels that are swapped in all images alike, told by the order of the lamps.

    ``expected`` is the handedness of the family's lamps; None when it has no three colours.
    """
    lamps = [frame.lamps for frame in frames if np.isfinite(frame.lamps).all()]
    if expected is None or not lamps or is_grey(frames, background):
        return []
    found = float(np.median([handedness(lamp) for lamp in lamps]))
    if abs(found) < HANDED or found * expected > 0:
        return []
    turn = {True: "clockwise", False: "counter-clockwise"}
    return [
        remarks.LAMPS_REVERSED(found=turn[found > 0], family=family, expected=turn[expected > 0])
    ]


def check_mixed(frames: Sequence[FrameFigures], grid: PixelGrid) -> list[Remark]:
    """Frames of two sensors (or framings) in one folder, by the gel beside their contacts; those
    that a contact mostly fills tell neither light nor gel."""
    size = thumb(frames[0].thumb, PAIR_THUMB_PX).shape[1::-1] if frames else (1, 1)
    seen = {i: _beside(frame, grid, size) for i, frame in enumerate(frames)}
    compared = [i for i, beside in seen.items() if beside.mean() >= MOSTLY]
    if len(compared) < MIN_MIXED:
        return []
    count = min(len(compared), MAX_PAIRED)
    pick = np.unique(np.take(compared, np.linspace(0, len(compared) - 1, count).astype(int)))
    # In the one light of the background, so that what differs is what they show.
    steady = [frames[i].light.remove(frames[i].thumb).astype(np.float32) for i in pick]
    small = [thumb(image, PAIR_THUMB_PX) for image in steady]
    distance = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            change = np.linalg.norm(small[i] - small[j], axis=-1)
            both = seen[pick[i]] & seen[pick[j]]
            distance[i, j] = distance[j, i] = float(
                np.median(change[both] if both.any() else change)
            )
    group = fcluster(linkage(squareform(distance), "average"), 2, "maxclust")
    first, second = (np.flatnonzero(group == k) for k in (1, 2))
    if not len(first) or not len(second):
        return []
    between = float(np.median(distance[np.ix_(first, second)]))
    inner = [
        float(np.median(distance[np.ix_(part, part)][~np.eye(len(part), dtype=bool)]))
        for part in (first, second)
        if len(part) > 1
    ]
    within = max(inner) if inner else 0.0
    if between < MIXED_MIN_LEVELS or between < MIXED_RATIO * within:
        return []
    fewer, more = sorted((first, second), key=len)
    names = [frames[pick[i]].press.name for i in fewer]
    return [
        remarks.MIXED_SENSORS(
            names=name_some(names),
            others=len(more),
            between=between,
            within=within,
            frames=names,
        )
    ]


def _beside(frame: FrameFigures, grid: PixelGrid, size: tuple[int, int]) -> np.ndarray:
    """Pixels of a small picture, as wide and high as ``size``, beside the contact, bool, [h, w]."""
    width, height = size
    if frame.circle is None:
        return np.ones((height, width), dtype=bool)
    scale = width / grid.width_px
    circle = ContactCircle(
        (frame.circle.u_px + 0.5) * scale - 0.5,
        (frame.circle.v_px + 0.5) * height / grid.height_px - 0.5,
        frame.circle.radius_px * scale,
    )
    ratio = grid.mm_per_px_y * grid.height_px * width / (grid.mm_per_px_x * grid.width_px * height)
    return circle.far(PixelGrid(width, height, min(1.0, 1 / ratio), min(1.0, ratio)), SUNK_RADII)
