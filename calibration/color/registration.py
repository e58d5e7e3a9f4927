# SPDX-License-Identifier: Apache-2.0
"""Contact circles read again with the help of the colours of all the other presses.

A circle that is clicked, or found where the colours change most, is off by a pixel or two; a colour
model that was fitted to other presses knows what a normal looks like and places the press to a
fraction of that. No press is placed by a fit that saw it. What the presses have in common, circles
that are all too large, is looked for first: a few scales are tried, and the one whose left-out
presses are predicted best is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.color.fit_options import SHORT_FIT, ColorFitOptions
from taccel_lab.calibration.color.frames import (
    ColorFrame,
    ColorSamples,
    draw_pixels,
    join_samples,
    samples_at,
)
from taccel_lab.calibration.color.training import train
from taccel_lab.calibration.color.untouched_light import light_beside
from taccel_lab.calibration.contacts.refine import refine_circle
from taccel_lab.calibration.surfaces.ball_in_layer import SurfaceMaker
from taccel_lab.calibration.surfaces.moved_press import MovedPress
from taccel_lab.calibration.surfaces.radial import RadialSurfaces
from taccel_lab.calibration.training import going_on
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.color_model import ColorModel

MIN_PRESSES = 8
"""Fewer presses say too little about each other."""
FOLDS = 2
ROUNDS = 2
SURE_DEVIATIONS = 2.0
"""A factor other than one is taken when the presses' gain is this many standard errors."""
CORRELATED_PIXELS = 25.0
"""Neighbouring pixels err alike: as many count as one."""
REACH = 1.8
"""Pixels up to this many contact radii are compared."""
MAX_PIXELS = 1500
SCALES = (0.86, 0.93, 1.0, 1.07)
"""Factors on all radii that are tried first, as far as they get better."""
NEAR_SCALE = 0.005
"""Factors that differ by less predict presses alike."""
WORTH = 0.01
"""Share of the loss that a factor other than one has to gain: fits that go on from one another
differ by less than they are wrong by."""
CENTER_SIGMA_PX = 2.0
"""How far a given circle's centre is thought to be off."""
RADIUS_SIGMA = 0.05
"""How far a given radius is thought to be off, as a share of it, beside what all have in common."""


@dataclass(frozen=True)
class Registration:
    """Circles as the colours have them."""

    circles: list[ContactCircle]
    scale: float
    """Factor on all radii that predicts left-out presses best."""


def register_presses(
    frames: Sequence[ColorFrame],
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    seed: int = 0,
    fit: ColorFitOptions = SHORT_FIT,
    scales: Sequence[float] = SCALES,
    progress: Callable[[int, int], None] | None = None,
) -> Registration:
    """Place the presses; ``frames`` hold the circles to start from and surfaces simulated there.

    ``fit`` are the settings of the short fits that place them; of ``scales``, factors on all radii,
    at least three are tried, one among them.

    Raises:
        InputError: Fewer than 8 presses.
    """
    if len(frames) < MIN_PRESSES:
        raise InputError(
            f"{len(frames)} presses are too few to place each by the others; at least {MIN_PRESSES}"
        )
    options = replace(fit, seed=seed)
    job = _Job(frames, background, grid, mask, options)
    total = len(scales) + 2 + ROUNDS
    done = 0

    def tell() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    circles = [frame.circle for frame in frames]
    scale = _best_scale(job, circles, scales, tell)
    circles = [replace(c, radius_px=c.radius_px * scale) for c in circles]
    start = circles
    for _ in range(ROUNDS):
        fits = [job.fit_without(circles, k) for k in range(FOLDS)]
        circles = [job.place(i, fits[i % FOLDS], circles[i], start[i]) for i in range(len(frames))]
        tell()
    return Registration(circles, scale)


def joining_frames(
    model: ColorModel,
    options: ColorFitOptions,
    frames: Sequence[ColorFrame],
    heldout: CaptureSet,
    scored: Sequence[ColorFrame],
    background: np.ndarray,
    surfaces: SurfaceMaker,
) -> list[ColorFrame]:
    """Held-out presses as a last fit takes them: placed by the colours of ``frames``, to which
    ``model`` was fitted, as these were by each other; with fewer than 8 of these, as ``scored``.

    ``scored`` are some presses of ``heldout`` where their labels put them; ``surfaces`` makes those
    under them anew.
    """
    if not scored or len(frames) < MIN_PRESSES:
        return list(scored)
    grid = heldout.grid
    job = _Job([*frames, *scored], background, grid, heldout.mask, options)
    names = {frame.name for frame in scored}
    # In the order of ``scored``: scores keep that of the captures.
    presses = tuple(press for press in heldout.presses if press.name in names)
    circles = []
    for i, (frame, press) in enumerate(zip(scored, presses, strict=True), len(frames)):
        circle = frame.circle
        for _ in range(ROUNDS):
            circle = job.place(i, model, circle, frame.circle)
        ball_mm = press.radius_mm or heldout.ball_radius_mm
        circles.append(circle.up_to_equator(ball_mm, grid))
    made = surfaces(replace(heldout, presses=presses), circles)
    return [
        replace(frame, circle=circle, surface=surface)
        for frame, circle, surface in zip(scored, circles, made, strict=True)
    ]


def _best_scale(
    job: _Job,
    circles: Sequence[ContactCircle],
    scales: Sequence[float],
    tell: Callable[[], None],
) -> float:
    """The factor on all radii with the least loss: one and its neighbours among ``scales``, further
    ones while the outermost is best, then two steps of a parabola."""
    losses: dict[float, np.ndarray] = {}

    def look(scale: float) -> None:
        losses[scale] = job.left_out_losses(
            [replace(c, radius_px=c.radius_px * scale) for c in circles]
        )
        tell()

    def best() -> float:
        return min(losses, key=lambda scale: float(losses[scale].mean()))

    ladder = sorted(scales)
    at = int(np.clip(ladder.index(1.0), 1, len(ladder) - 2))
    low, high = at - 1, at + 1
    for scale in ladder[low : high + 1]:
        look(scale)
    while low > 0 and best() == ladder[low]:
        look(ladder[low := low - 1])
    while high < len(ladder) - 1 and best() == ladder[high]:
        look(ladder[high := high + 1])
    for _ in range(2):
        x = np.array(sorted(losses))
        y = np.array([losses[scale].mean() for scale in x])
        middle = int(np.clip(np.argmin(y), 1, len(x) - 2))
        a, b, _ = np.polyfit(x[middle - 1 : middle + 2], y[middle - 1 : middle + 2], 2)
        lowest = -b / (2 * a) if a > 0 else x[int(np.argmin(y))]
        lowest = round(float(np.clip(lowest, x[middle - 1], x[middle + 1])), 3)
        if np.abs(x - lowest).min() < NEAR_SCALE:
            break
        look(lowest)
    gain = losses[1.0] - losses[best()]
    sure = gain.mean() > SURE_DEVIATIONS * gain.std(ddof=1) / np.sqrt(len(gain))
    return best() if sure and gain.mean() > WORTH * losses[1.0].mean() else 1.0


class _Job:
    """Presses, their pixels, and the short fits."""

    def __init__(
        self,
        frames: Sequence[ColorFrame],
        background: np.ndarray,
        grid: PixelGrid,
        mask: np.ndarray | None,
        options: ColorFitOptions,
    ) -> None:
        self.frames, self.grid, self.mask, self.options = list(frames), grid, mask, options
        self.drifts = [light_beside(f.image, background, f.circle, grid, mask) for f in frames]
        self.rest_image = background
        self.library = RadialSurfaces.of(
            [frame.surface for frame in frames], [frame.circle for frame in frames], grid
        )
        self.moved = [MovedPress.of(f.surface, f.circle, self.library) for f in frames]
        rng = np.random.default_rng(options.seed)
        self.pixels = [draw_pixels(frame, grid, mask, options, rng) for frame in frames]
        self.again = going_on(options)
        self._first: dict[int, ColorModel] = {}

    def samples(self, i: int, circle: ContactCircle) -> ColorSamples:
        """The drawn pixels of a press as if its contact were ``circle``."""
        idx, frame = self.pixels[i], self.frames[i]
        found = samples_at(frame, idx, self.rest_image, self.drifts[i], self.grid)
        near = ~frame.circle.untouched(self.grid).ravel()[idx]
        normals, sunk = self.moved[i].at(circle, idx[near])
        found.normals[near] = normals
        found.displacement_mm[near] = sunk
        return found

    def fit_without(self, circles: Sequence[ContactCircle], fold: int) -> ColorModel:
        """A short fit to the presses whose index modulo the number of folds is not ``fold``.

        The first one of a fold, to the circles as they came, is what all later ones go on from:
        they have seen the same presses, and each has taken as many steps.
        """
        kept = [i for i in range(len(self.frames)) if i % FOLDS != fold]
        if fold not in self._first:
            given = [self.frames[i].circle for i in kept]
            start = join_samples([self.samples(i, c) for i, c in zip(kept, given, strict=True)])
            self._first[fold] = train(start, self.grid, self.options).model
        samples = join_samples([self.samples(i, circles[i]) for i in kept])
        return train(samples, self.grid, self.again, start=self._first[fold]).model

    def left_out_losses(self, circles: Sequence[ContactCircle]) -> np.ndarray:
        """Mean absolute error of each press by a fit without it [levels], shape [press]."""
        losses = np.zeros(len(self.frames))
        for fold in range(FOLDS):
            model = self.fit_without(circles, fold)
            for i in range(fold, len(self.frames), FOLDS):
                s = self.samples(i, circles[i])
                change = model.predict_pixels(
                    self.pixels[i], s.normals, s.displacement_mm, s.rest_normals
                )
                losses[i] = np.abs(change - s.change).mean()
        return losses

    def place(
        self, i: int, model: ColorModel, start: ContactCircle, prior: ContactCircle
    ) -> ContactCircle:
        """The circle where the render of a press meets its image best."""
        frame = self.frames[i]
        near = start.distance_px(self.grid) <= REACH * start.radius_px
        if self.mask is not None:
            near &= self.mask
        idx = np.flatnonzero(near)
        idx = idx[:: max(1, len(idx) // MAX_PIXELS)]
        light = self.drifts[i].at(idx, self.grid.height_px, self.grid.width_px)
        wanted = light.remove(frame.image.reshape(-1, 3)[idx].astype(np.float64))
        wanted -= self.rest_image.reshape(-1, 3)[idx]
        rest = frame.surface.rest_normals.reshape(-1, 3)[idx]

        def misfit(circle: ContactCircle) -> np.ndarray:
            normals, sunk = self.moved[i].at(circle, idx)
            return (model.predict_pixels(idx, normals, sunk, rest) - wanted).ravel()

        deviation = np.array([CENTER_SIGMA_PX, CENTER_SIGMA_PX, RADIUS_SIGMA * prior.radius_px])
        # Pixels beside each other err alike, and the channels of a pixel do.
        share = 1.0 / (3 * CORRELATED_PIXELS * len(idx) / max(1, near.sum()))
        return refine_circle(misfit, start, prior, deviation, min(share, 1.0 / 3))
