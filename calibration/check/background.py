# SPDX-License-Identifier: Apache-2.0
"""Findings about the background: missing, of another framing or gel, of another light, or pressed.

The median of the presses tells of the untouched gel wherever fewer than half of them touch it. What
most presses touch is no untouched gel: there the median shows a press, and a background that does
not is right to differ from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.framing import (
    CLEAR_GAIN,
    OTHER_FRAMING_LEVELS,
    best_channel_order,
    in_light_of,
    median_image,
    misfit_levels,
)
from taccel_lab.calibration.capture.sensor_facts import sensor_facts
from taccel_lab.calibration.check import remarks
from taccel_lab.calibration.check.remarks import BACKGROUND_PRESSED, MEDIAN_PRESSED
from taccel_lab.calibration.circles.color_change import WorkingSize
from taccel_lab.calibration.circles.contact_finder import seen_contact
from taccel_lab.calibration.circles.labels import DetectedContact
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.processes.ahead import ahead
from taccel_lab.processes.process_pool import one_blas_thread
from taccel_lab.reading.light import enough_pixels
from taccel_lab.reading.thumb import SmallImage, resized, thumb
from taccel_lab.reading.whose import FINE_PX, FINE_SHARE, ITS_OWN, Pattern
from taccel_lab.report.remark import Remark

MIN_MEDIAN_PRESSES = 7
DARK_LEVELS = 8.0
_MEDIAN = "The median of the presses stands in for it; --background median of import keeps it"
_USED = (
    " The median of the presses is used here, and as the background with capture import "
    "--background median"
)
MOST = 0.5
"""Part of the contacts above which their common place is touched in the median of the presses."""
AWAY_RADII = 3.0
"""Contact radii beyond which large contacts have no part in the median's colours, either."""
SAME_PICTURE_LEVELS = 1.0
"""Largest difference of two small pictures up to which one is the other: an image of the untouched
gel differs from the median of presses where most of them touch."""
MAX_WITNESSES = 10
"""Presses whose gel's pattern is held against that of the background."""
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


@dataclass(frozen=True)
class BackgroundCheck:
    """The picture of the untouched gel that the other checks compare with."""

    image: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]: the background, or the median of the presses."""
    is_median: bool
    findings: tuple[Remark, ...]


def median_background(presses: Sequence[CapturedPress]) -> np.ndarray:
    """Median of the presses, RGB uint8: untouched where no pixel is pressed in half of them.

    It is that of their pictures at the working size of contacts, as large as theirs.
    """
    height, width = presses[0].image().shape[:2]
    size = WorkingSize(PixelGrid(width, height, 1.0, 1.0))
    median = median_image([lambda press=press: size.picture(press.image()) for press in presses])
    return size.enlarged(median)


def check_background(folder: CaptureFolder) -> BackgroundCheck:
    """Judge the background against the median of the presses, once a folder.

    Raises:
        InputError: There is none, and too few presses for their median, or most touch one place.
    """
    return folder.once.of("background", lambda: _judged(folder))


def _judged(folder: CaptureFolder) -> BackgroundCheck:
    presses = folder.presses
    enough = len(presses) >= MIN_MEDIAN_PRESSES
    if folder.background is None:
        if not enough:
            raise InputError(
                f"{folder.source}: no background and {len(presses)} presses; give an image of the "
                f"untouched sensor, or at least {MIN_MEDIAN_PRESSES} presses for their median"
            )
        whole_median = median_background(presses)
        if (fault := _Touched.of(folder, whole_median).fault_of_median) is not None:
            raise InputError(fault.message)
        return BackgroundCheck(whole_median, True, (remarks.NO_BACKGROUND(instead=_MEDIAN),))
    image = folder.background.image()
    if len(presses) < 3:
        return BackgroundCheck(image, False, ())
    whole_median = median_background(presses)
    small, median = thumb(image), thumb(whole_median)
    misfit = misfit_levels(median, small)
    own = float(np.median([misfit_levels(thumb(press.image()), median) for press in presses[:20]]))
    if misfit < OTHER_FRAMING_LEVELS or misfit < CLEAR_GAIN * own:
        if enough and np.abs(small - median).max() < SAME_PICTURE_LEVELS:
            fault = _Touched.of(folder, image).fault_of_median
            return BackgroundCheck(image, True, () if fault is None else (fault,))
        pressed = find_pressed_background(image, _picked(presses), folder.mask)
        if pressed is not None:
            return BackgroundCheck(whole_median if enough else image, enough, (pressed,))
        return BackgroundCheck(image, False, tuple(_check_untouched(folder)))
    if _is_dark(folder, image):
        reason, advice = "it is black, lamps off or the wrong file", ""
    else:
        order, swapped, _ = best_channel_order(small, median)
        if order != (0, 1, 2) and swapped * CLEAR_GAIN < misfit:
            # Said by the check of channels, which sees all images against each other.
            return BackgroundCheck(np.ascontiguousarray(image), False, ())
        if _differs_where_touched(folder, image, median):
            return BackgroundCheck(image, False, tuple(_check_untouched(folder)))
        reason = (
            f"{misfit:.0f} levels apart after exposure and white balance are fitted, the presses "
            f"among themselves {own:.0f}; of another sensor, framing, time or lamp setting"
        )
        advice = _USED if enough else ""
    fault = _Touched.of(folder, whole_median).fault_of_median if enough else None
    if fault is not None:
        enough, advice = False, f" And {fault.message}"
    finding = remarks.BACKGROUND_DIFFERS(reason=reason, advice=advice)
    return BackgroundCheck(whole_median if enough else image, enough, (finding,))


def _picked(presses: Sequence[CapturedPress]) -> Sequence[CapturedPress]:
    return presses[:: max(1, len(presses) // MAX_COMPARED)][:MAX_COMPARED]


@dataclass(frozen=True)
class _Touched:
    """Places that presses touch, by the contacts that stand out of a background."""

    circles: tuple[ContactCircle, ...]
    looked_at: int
    """Presses that were."""
    grid: PixelGrid

    @classmethod
    def of(cls, folder: CaptureFolder, background: np.ndarray) -> _Touched:
        """The contacts of up to thirty presses; those of ``measure_presses`` in this background."""
        height, width = background.shape[:2]
        grid = PixelGrid(width, height, *(folder.mm_per_px or (1.0, 1.0)))
        facts = sensor_facts(folder.sensor, folder.design)
        grey = "grey" if facts is not None and facts.is_grey else None
        look = partial(seen_contact, background=background, grid=grid, mask=folder.mask, grey=grey)
        picked = _picked(folder.presses)
        with one_blas_thread():
            found = [one for one in ahead(look, picked) if isinstance(one, DetectedContact)]
        return cls(tuple(one.circle for one in found), len(picked), grid)

    @property
    def by_most(self) -> bool:
        """One place lies in most contacts."""
        return len(self.circles) >= MIN_WITNESSES and bool(self._shares.max() > MOST)

    @cached_property
    def _shares(self) -> np.ndarray:
        """Part of the contacts that each pixel lies in, shape [height_px, width_px]."""
        inside = [c.distance_px(self.grid) <= c.radius_px for c in self.circles]
        return np.mean(inside, axis=0)

    @property
    def fault_of_median(self) -> Remark | None:
        """A reason that the median of the presses, out of which contacts stand, is no untouched
        gel; None where it is one."""
        if len(self.circles) < MIN_WITNESSES:
            reason = (
                f"a contact stands out of it in {len(self.circles)} of {self.looked_at} presses"
            )
            return MEDIAN_PRESSED(reason=reason)
        if not self.by_most:
            return None
        shares = self._shares
        v, u = np.argwhere(shares == shares.max()).mean(axis=0)
        most, count = round(float(shares.max()) * len(self.circles)), len(self.circles)
        reason = f"{most} of {count} contacts lie over one place, around ({u:.0f}, {v:.0f}) px"
        return MEDIAN_PRESSED(reason=reason)

    def beside(self, mask: np.ndarray | None) -> np.ndarray:
        """Pixels that most presses leave at rest, bool, shape [height_px, width_px]."""
        far = [circle.far(self.grid, AWAY_RADII, mask) for circle in self.circles]
        return np.mean(far, axis=0) > MOST


def _differs_where_touched(folder: CaptureFolder, image: np.ndarray, median: np.ndarray) -> bool:
    """A background (RGB levels) and the median of the presses (small) are of one gel, and differ
    only where most presses touch it."""
    if _is_of_another_gel(folder, image):
        return False
    touched = _Touched.of(folder, image)
    if 2 * len(touched.circles) <= touched.looked_at or not touched.by_most:
        return False
    beside = touched.beside(folder.mask).astype(np.float32)
    rest = resized(beside, median.shape[1::-1]) >= 1.0
    return enough_pixels(rest) and misfit_levels(median, thumb(image), rest) < OTHER_FRAMING_LEVELS


def _is_of_another_gel(folder: CaptureFolder, image: np.ndarray) -> bool:
    """The finest pattern of a background's gel is in few of the presses."""
    known = Pattern(SmallImage.of(image, folder.mask, FINE_PX), FINE_SHARE)
    if not known.is_clear:
        return False
    seen = [SmallImage.of(p.image(), folder.mask, FINE_PX) for p in folder.presses[:MAX_WITNESSES]]
    alike = [known.agreement(one, np.ones(3)) for one in seen]
    told = [one for one in alike if one is not None]
    return bool(told) and float(np.median(told)) < ITS_OWN


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
