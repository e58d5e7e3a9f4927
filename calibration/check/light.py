# SPDX-License-Identifier: Apache-2.0
"""Findings about light: drift, saturation, channel order, another sensor's frames, and a background
that is missing, of another framing, of another light, or with a contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.framing import (
    CLEAR_GAIN,
    OTHER_FRAMING_LEVELS,
    best_channel_order,
    in_light_of,
    misfit_levels,
)
from taccel_lab.calibration.capture.sensor_facts import handedness
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.frames import FrameFigures
from taccel_lab.calibration.check.remarks import BACKGROUND_PRESSED
from taccel_lab.calibration.circles.color_change import WorkingSize
from taccel_lab.calibration.light_drift import drift_remarks
from taccel_lab.calibration.remarks import name_some
from taccel_lab.errors import InputError
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
MIN_MEDIAN_PRESSES = 7
DARK_LEVELS = 8.0
_MEDIAN = "The median of the presses stands in for it; --background median of import keeps it"
MIN_PRESSES = 5
MIN_GHOST_LEVELS = 12.0
GHOST_SHARE = 0.3
"""Strength of the ghost against that of the presses' own contacts."""
GHOST_AREA = 0.25
"""Its area against that of a contact: dust that settled later is smaller."""
AGREE = 0.35
"""Presses that see the ghost differ from each other there by this share of it at most."""
MIN_WITNESSES = 3
MAX_COMPARED = 30
"""Presses that are held against the background."""
OPENING_SHARE = 1 / 40
"""Half width of what is too small for a contact, as a part of the image's shorter side."""


def check_light(frames: Sequence[FrameFigures], background: np.ndarray) -> list[Remark]:
    """All findings of this module that need presses and a background (small, RGB levels)."""
    swapped = check_channel_order(frames, background)
    if swapped:  # Drift and other sensors would be found as a consequence.
        return [*swapped, *_check_saturation(frames)]
    return [*_check_drift(frames, background), *_check_saturation(frames), *check_mixed(frames)]


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


def check_mixed(frames: Sequence[FrameFigures]) -> list[Remark]:
    """Frames of two sensors (or framings) in one folder."""
    if len(frames) < MIN_MIXED:
        return []
    pick = np.unique(np.linspace(0, len(frames) - 1, min(len(frames), MAX_PAIRED)).astype(int))
    # In the one light of the background, so that what differs is what they show.
    steady = [frames[i].light.remove(frames[i].thumb).astype(np.float32) for i in pick]
    small = [thumb(image, PAIR_THUMB_PX) for image in steady]
    count = len(small)
    distance = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            change = np.linalg.norm(small[i] - small[j], axis=-1)
            distance[i, j] = distance[j, i] = float(np.median(change))
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


@dataclass(frozen=True)
class BackgroundCheck:
    """Which picture of the untouched gel the other checks compare with."""

    image: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]: the background, or the median of the presses."""
    is_median: bool
    findings: tuple[Remark, ...]


def median_background(presses: Sequence[CapturedPress]) -> np.ndarray:
    """Median of the presses, RGB uint8: untouched where no pixel is pressed in half of them.

    It is that of their pictures at the working size of contacts, as large as theirs.
    """
    from taccel_lab.calibration.capture.framing import median_image

    height, width = presses[0].image().shape[:2]
    size = WorkingSize(PixelGrid(width, height, 1.0, 1.0))
    median = median_image([lambda press=press: size.picture(press.image()) for press in presses])
    return size.enlarged(median)


def check_background(folder: CaptureFolder) -> BackgroundCheck:
    """Judge the background against the median of the presses, once a folder.

    Raises:
        InputError: There is none, and too few presses for their median.
    """
    return folder.once.of("background", lambda: _judged(folder))


def _judged(folder: CaptureFolder) -> BackgroundCheck:
    presses = folder.presses
    if folder.background is None:
        if len(presses) < MIN_MEDIAN_PRESSES:
            raise InputError(
                f"{folder.source}: no background and {len(presses)} presses; give an image of the "
                f"untouched sensor, or at least {MIN_MEDIAN_PRESSES} presses for their median"
            )
        return BackgroundCheck(
            median_background(presses), True, (remarks.NO_BACKGROUND(instead=_MEDIAN),)
        )
    image = folder.background.image()
    if len(presses) < 3:
        return BackgroundCheck(image, False, ())
    median_image = median_background(presses)
    small, median = thumb(image), thumb(median_image)
    misfit = misfit_levels(median, small)
    own = float(np.median([misfit_levels(thumb(press.image()), median) for press in presses[:20]]))
    if misfit < OTHER_FRAMING_LEVELS or misfit < CLEAR_GAIN * own:
        picked = presses[:: max(1, len(presses) // MAX_COMPARED)][:MAX_COMPARED]
        pressed = find_pressed_background(image, picked, folder.mask)
        if pressed is not None:
            enough = len(presses) >= MIN_MEDIAN_PRESSES
            return BackgroundCheck(median_image if enough else image, enough, (pressed,))
        return BackgroundCheck(image, False, tuple(_check_untouched(folder)))
    enough = len(presses) >= MIN_MEDIAN_PRESSES
    if _is_dark(folder, image):
        reason = "it is black, lamps off or the wrong file"
        finding = remarks.BACKGROUND_DIFFERS(reason=reason, advice="")
        return BackgroundCheck(median_image if enough else image, enough, (finding,))
    order, swapped, _ = best_channel_order(small, median)
    if order != (0, 1, 2) and swapped * CLEAR_GAIN < misfit:
        # Said by the check of channels, which sees all images against each other.
        return BackgroundCheck(np.ascontiguousarray(image), False, ())
    advice = (
        " The median of the presses is used here, and as the background with capture import "
        "--background median"
        if enough
        else ""
    )
    reason = (
        f"{misfit:.0f} levels apart after exposure and white balance are fitted, the presses "
        f"among themselves {own:.0f}; of another sensor, framing, time or lamp setting"
    )
    finding = remarks.BACKGROUND_DIFFERS(reason=reason, advice=advice)
    chosen = median_image if enough else image
    return BackgroundCheck(chosen, enough, (finding,))


def _is_dark(folder: CaptureFolder, background: np.ndarray) -> bool:
    """Whether a background that is used as a whole is black."""
    return folder.mask is None and bool(background.mean() < DARK_LEVELS)


def _check_untouched(folder: CaptureFolder) -> list[Remark]:
    """Further images of the untouched sensor: how far it has drifted."""
    background = folder.require_background().image()
    if _is_dark(folder, background):
        return [remarks.BACKGROUND_DIFFERS(reason="it is black", advice="")]
    found = []
    for frame in folder.untouched:
        misfit = misfit_levels(thumb(frame.image()), thumb(background))
        if misfit > OTHER_FRAMING_LEVELS:
            found.append(
                remarks.UNTOUCHED_DIFFERS(name=frame.name, misfit=misfit, frames=[frame.name])
            )
    return found


def find_pressed_background(
    background: np.ndarray, presses: Sequence[CapturedPress], mask: np.ndarray | None = None
) -> Remark | None:
    """An error when the background shows a contact that most of the presses do not.

    What only the background shows stands, negative, at one place of every press, also of those that
    touch the gel elsewhere. The median of the presses shows it as well, but so it does a place
    where nearly all presses were made; hence only presses whose own contact lies elsewhere count.
    ``background`` is RGB levels of the presses' size, shape [height_px, width_px, 3]; pixels where
    ``mask`` is false have no effect.
    """
    if len(presses) < MIN_PRESSES:
        return None
    small = thumb(_blanked(background, mask))
    used = np.ones((*small.shape[:2], 1), dtype=np.float32)
    if mask is not None:
        used[thumb(np.repeat(mask[..., None], 3, axis=-1).astype(np.float32)).min(axis=-1) < 1] = 0
    stack = np.stack(
        [
            cv2.GaussianBlur((t - in_light_of(t, small)) * used, (0, 0), 1.0)
            for t in (thumb(_blanked(press.image(), mask)) for press in presses)
        ]
    )
    common = np.median(stack, axis=0)
    size = np.linalg.norm(common, axis=-1)
    apart = np.linalg.norm(stack - common, axis=-1)
    typical = float(np.median([np.percentile(own, 99) for own in apart]))
    floor = max(MIN_GHOST_LEVELS, GHOST_SHARE * typical)
    ghost = _largest_part(size > floor)
    own = apart > floor
    if ghost.sum() < GHOST_AREA * max(1.0, float(np.median(own.sum(axis=(1, 2))))):
        return None
    near = cv2.dilate(ghost.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    elsewhere = (own & ~near).sum(axis=(1, 2)) >= 0.5 * ghost.sum()
    alike = np.median(apart[:, ghost], axis=1) < AGREE * float(np.median(size[ghost]))
    if (elsewhere & alike).sum() < max(MIN_WITNESSES, 0.5 * elsewhere.sum()):
        return None
    rows, columns = np.nonzero(ghost)
    scale = background.shape[1] / small.shape[1]
    return BACKGROUND_PRESSED(
        u=columns.mean() * scale,
        v=rows.mean() * scale,
        count=int((elsewhere & alike).sum()),
        levels=float(np.median(size[ghost])),
    )


def _blanked(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Masked pixels take the mean of the others, so that the fit of the levels is hardly moved."""
    if mask is None:
        return image
    return np.where(mask[..., None], image, image[mask].mean(axis=0)).astype(image.dtype)


def _largest_part(found: np.ndarray) -> np.ndarray:
    """The largest connected area that is left by an opening, bool."""
    width = 2 * max(1, round(min(found.shape) * OPENING_SHARE)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    opened = cv2.morphologyEx(found.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(opened)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return parts == 1 + int(np.argmax(areas)) if len(areas) else np.zeros(found.shape, dtype=bool)
