# SPDX-License-Identifier: Apache-2.0
"""What is measured on every press: light, contact, sharpness, saturation, direction of the lamps"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.check.picture_figures import PictureFigures, mean_of_channels
from taccel_lab.calibration.circles.color_change import WorkingSize
from taccel_lab.calibration.circles.contact_finder import seen_contact
from taccel_lab.calibration.circles.labels import CutContactError, DetectedContact, UntouchedError
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.processes.ahead import ahead
from taccel_lab.processes.process_pool import one_blas_thread
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.light import LightDrift, LightFit
from taccel_lab.reading.thumb import SmallImage
from taccel_lab.reading.whole_frame import BrokenFrameError
from taccel_lab.signals.depth_response import Channel

SATURATED_LEVEL = 254
TEXTURE_SIGMA_PX = 1.5
UNTOUCHED_RADII = 2.0
LAMP_RADII = 0.9
"""Part of the contact disc over which the direction of each lamp is fitted."""


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one press."""

    press: CapturedPress
    thumb: np.ndarray
    """The image made small, RGB levels, float32."""
    rest: np.ndarray
    """The background made small, one array for all presses."""
    light: LightDrift
    """Light of the frame against the background."""
    shift_levels: np.ndarray
    """Colour of the untouched gel less that of the background, at its mean colour, shape [3]."""
    contact: DetectedContact | None
    fault: str
    """Why no contact was found; empty when one was."""
    cut: bool
    """Whether the border of the image cuts the contact."""
    broken: bool
    """Whether the image did not come whole from the camera."""
    untouched: bool
    """Whether nothing in the image stands out from the noise."""
    saturated_share: float
    """Pixels of the contact (of the image, without one) with a channel at 254 or above."""
    texture: float
    """How much of the background's fine texture is seen beside the contact: 1 all of it."""
    texture_correlation: float
    picture: PictureFigures
    rim_px: float
    """Width over which the colour changes at its steepest [px], at the working size of contacts;
    NaN without a contact."""
    lamps: np.ndarray
    """Slope of each channel's colour change across the contact (levels a radius, along u and v),
    shape [3, 2]; NaN without a contact."""

    @property
    def reference(self) -> np.ndarray:
        """The background in this frame's light, as small."""
        return self.light.apply(self.rest).astype(np.float32)

    @property
    def circle(self) -> ContactCircle | None:
        """The contact as found, or else as given."""
        return self.contact.circle if self.contact is not None else self.press.circle


def measure_presses(
    presses: Sequence[CapturedPress],
    background: np.ndarray,
    mask: np.ndarray | None,
    grid: PixelGrid,
    progress: Progress = silent,
    grey: Channel | None = None,
) -> list[FrameFigures]:
    """Figures of every press against a background of the same framing (RGB uint8), of a ``grey``
    sensor by the channel that darkens with depth."""
    known, size = SmallImage.of(background), WorkingSize(grid)
    worked = size.picture(background)
    measure = partial(
        _measure,
        background=background,
        worked=worked,
        known_grain=grain(worked),
        rest=known.levels,
        fit=LightFit(known),
        mask=mask,
        grid=grid,
        grey=grey,
    )
    with one_blas_thread():  # A thread a press is enough.
        measured = ahead(measure, presses)
        return list(counted(measured, progress, "checking the presses", len(presses)))


def _measure(
    press: CapturedPress,
    background: np.ndarray,
    worked: np.ndarray,
    known_grain: np.ndarray,
    rest: np.ndarray,
    fit: LightFit,
    mask: np.ndarray | None,
    grid: PixelGrid,
    grey: Channel | None,
) -> FrameFigures:
    """Figures of one press; ``worked`` is the background at the working size, with its grain."""
    image = press.image()
    small = SmallImage.of(image)
    light = fit.still(small)
    picture = PictureFigures.of(image, small.levels)
    found = seen_contact(press, background, grid, mask, grey)
    contact = None if isinstance(found, InputError) else found
    circle = contact.circle if contact is not None else press.circle
    size = WorkingSize(grid)
    saturated = size.picture((image.max(axis=-1) >= SATURATED_LEVEL).astype(np.float32))
    image = size.picture(image)
    mask = size.mask(mask)
    disc = np.ones(image.shape[:2], dtype=bool) if mask is None else mask.copy()
    beside = disc.copy()
    rim, lamps = float("nan"), np.full((3, 2), np.nan)
    if circle is not None:
        own = size.circle(circle)
        distance = own.distance_px(size.grid)
        disc &= distance <= own.radius_px
        beside &= distance > UNTOUCHED_RADII * own.radius_px
        lit = np.clip(light.apply(worked), 0, 255).astype(np.float32)
        change = image.astype(np.float32) - lit
        rim = size.factor * _rim_width(change, distance, own.radius_px)
        lamps = _lamp_slopes(change, distance, own)
    texture, correlation = texture_seen(grain(image), known_grain, beside)
    return FrameFigures(
        press=press,
        thumb=small.levels,
        rest=rest,
        light=light,
        shift_levels=light.shift(rest.reshape(-1, 3).mean(axis=0)),
        contact=contact,
        fault="" if contact is not None else str(found).removeprefix(f"{press.source}: "),
        cut=isinstance(found, CutContactError),
        broken=isinstance(found, BrokenFrameError),
        untouched=isinstance(found, UntouchedError),
        saturated_share=float(saturated[disc].mean(dtype=np.float64)) if disc.any() else 0.0,
        texture=texture,
        texture_correlation=correlation,
        picture=picture,
        rim_px=rim,
        lamps=lamps,
    )


def texture_seen(seen: np.ndarray, known: np.ndarray, beside: np.ndarray) -> tuple[float, float]:
    """Regression of an image's ``grain`` on the background's, and their correlation.

    Camera noise is not shared between the two, so that it does not count as sharpness, as it does
    in the variance of the Laplacian.
    """
    a, b = known[beside], seen[beside]
    if a.size < 500 or not a.std() > 0 or not b.std() > 0:
        return float("nan"), 0.0
    shared = float((a * b).mean() - a.mean() * b.mean())
    return shared / float(a.var()), shared / float(a.std() * b.std())


def grain(image: np.ndarray) -> np.ndarray:
    """Fine structure of an image [levels], shape [height_px, width_px]."""
    grey = mean_of_channels(image)
    return grey - cv2.GaussianBlur(grey, (0, 0), TEXTURE_SIGMA_PX)


def _rim_width(change: np.ndarray, distance: np.ndarray, radius: float) -> float:
    """Colour change over its steepest gradient, both near the contact [px]."""
    near = distance <= 1.3 * radius
    if not near.any():  # A labelled circle outside of the picture.
        return float("nan")
    smooth = cv2.GaussianBlur(change, (0, 0), 0.8)
    gradient = np.hypot(
        *(np.linalg.norm(cv2.Sobel(smooth, cv2.CV_32F, dx, dy) / 8, axis=-1) for dx, dy in _AXES)
    )
    steepest = float(np.percentile(gradient[near], 99))
    return float(np.percentile(np.linalg.norm(smooth[near], axis=-1), 99)) / max(steepest, 1e-6)


_AXES = ((1, 0), (0, 1))


def _lamp_slopes(change: np.ndarray, distance: np.ndarray, circle: ContactCircle) -> np.ndarray:
    inside = distance <= LAMP_RADII * circle.radius_px
    if inside.sum() < 20:
        return np.full((3, 2), np.nan)
    v, u = np.nonzero(inside)
    design = np.column_stack(
        [
            (u - circle.u_px) / circle.radius_px,
            (v - circle.v_px) / circle.radius_px,
            np.ones(len(u)),
        ]
    )
    slopes, *_ = np.linalg.lstsq(design, change[inside].astype(np.float64), rcond=None)
    return slopes[:2].T
