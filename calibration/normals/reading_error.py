# SPDX-License-Identifier: Apache-2.0
"""How far normals and heights are off, found on presses of known surface that were not seen.

Those are synthetic presses that no network saw, and every training ball as read by the network that
did not see it. Where a ball is, is known to a pixel or two only: what its centre may be off by is
taken off the errors of normals, so that their radius does not have to hold errors of labels.

Heights are stated as absolute ones. Synthetic presses are exact and say what the reading adds.
Balls say what comes on top, an error that lies along the slope all around the dent. How much of it
is that of each circle and how much the reading's they do not tell apart, so that all of it counts.
What is wrong in all circles alike, in the scale or in the gel's law was learnt along and shows in
no error: it is given as a share of the depth.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.cross_conformal import MIN_PRESSES, radius_factor
from taccel_lab.calibration.normals.samples import KnownPress, angle_between_deg
from taccel_lab.calibration.response.frame import CaptureScene
from taccel_lab.networks.normal_settings import RAYLEIGH_95
from taccel_lab.signals.normal_model import NormalModel, relative_normals
from taccel_lab.signals.read_heights import (
    BAND_SIGMAS,
    HeightUncertainty,
    ReadHeights,
    read_heights,
)

LENGTHS_PX = (4.0, 8.0, 16.0)
"""Distances over which neighbours may err together that are tried."""
EVERY_PX = 2
"""Rows and columns apart that presses are read for their errors alone. All of them take three times
as long; on FOTS they change factors by up to 2.5 %, errors of heights by 0.5 %."""
SHARE = 0.95
LEAST_M = 1e-9


@dataclass(frozen=True)
class SyntheticScore:
    """Absolute errors of heights on presses of other tools."""

    rmse_mm: float
    """Error over the dents: root of the mean over presses of the mean square."""
    median_press_share: float
    """Median over presses of the root mean square in the dent over its deepest point: presses go as
    deep as the balls of the captures did, on one sensor 0.1 to 0.9 mm, on another 0.3 to 2."""
    worst_press_mm: float
    within_95: float
    """Share of the dents' pixels in the band of 95 %, presses of equal weight; these presses set
    the band, so that it tells how even it is, not how true."""
    normals_within_95: float
    """Share of them in the radius of 95 %, likewise."""
    count: int


@dataclass(frozen=True)
class ReadingErrors:
    """Errors of some pixels of a press that was read, shape [n] each."""

    angle_sigmas: np.ndarray
    """Angles over the expected standard deviation, what the ball's centre may be off by taken
    off."""
    height_m: np.ndarray
    """Errors of heights."""
    spreads_m: Sequence[np.ndarray]
    """Standard deviations of heights before any factor, for each of ``LENGTHS_PX``."""
    along_m: np.ndarray
    """Height that is off where all slopes are too steep by what is expected of them."""
    deepest_m: float
    """How deep the press is."""


def with_reading_errors(
    model: NormalModel,
    synthetic_presses: Iterable[KnownPress],
    balls: Iterable[KnownPress],
    scene: CaptureScene,
    depth_share: float,
) -> tuple[NormalModel, SyntheticScore | None]:
    """The model with its radius of 95 % and the spread of its heights, and how well it read the
    synthetic presses.

    All factors are those that hold 95 % of a new press's pixels in the mean (cross-conformal): the
    radius on synthetic presses or on captured balls, whichever asks for more, the spread of the
    reading on synthetic presses, and what comes on top along the slopes on balls. Heights have a
    spread where there are synthetic presses; the length over which errors go together is
    the one with the narrowest band. ``depth_share`` is what all readings may be off by
    (``ball_surface.depth_share``).
    """
    drawn = all_errors(model, synthetic_presses, scene)
    captured = all_errors(model, balls, scene)
    groups = [group for group in (drawn, captured) if group]
    if not groups:
        return model, None
    radius = max(radius_factor([e.angle_sigmas for e in g], SHARE, RAYLEIGH_95) for g in groups)
    config = replace(model.config, radius95_sigmas=radius)
    if not drawn:
        return NormalModel(config, model.weights), None

    def band(k: int) -> tuple[float, int, float]:
        """Mean width, the length, and the factor that holds the share."""
        over = [e.height_m / e.spreads_m[k] for e in drawn]
        factor = radius_factor(over, SHARE, BAND_SIGMAS) / BAND_SIGMAS
        return factor * float(np.mean([e.spreads_m[k].mean() for e in drawn])), k, factor

    _, k, factor = min(map(band, range(len(LENGTHS_PX))))
    config = replace(
        config, error_length_px=LENGTHS_PX[k], height_factor=factor, depth_share=depth_share,
        along_factor=_along_factor(captured, k, factor),
    )  # fmt: skip
    dents = [float(1e3 * np.sqrt(np.mean(e.height_m**2))) for e in drawn]
    deepest_mm = [1e3 * e.deepest_m for e in drawn]
    score = SyntheticScore(
        rmse_mm=float(np.sqrt(np.mean(np.square(dents)))),
        median_press_share=float(np.median(np.divide(dents, deepest_mm))),
        worst_press_mm=float(np.max(dents)),
        within_95=float(
            np.mean([np.mean(e.height_m <= BAND_SIGMAS * factor * e.spreads_m[k]) for e in drawn])
        ),
        normals_within_95=float(np.mean([np.mean(e.angle_sigmas <= radius) for e in drawn])),
        count=len(dents),
    )
    return NormalModel(config, model.weights), score


def widened(model: NormalModel, found: Sequence[ReadingErrors]) -> NormalModel:
    """The model with bands that hold 95 % of presses that nothing had seen, too, where they were
    narrower; as it is where there are fewer than ``MIN_PRESSES`` of those."""
    if len(found) < MIN_PRESSES:
        return model
    config = model.config
    radius = radius_factor([e.angle_sigmas for e in found], SHARE, RAYLEIGH_95)
    along = config.along_factor
    if config.height_factor > 0:
        k = LENGTHS_PX.index(config.error_length_px)
        along = max(along, _along_factor(found, k, config.height_factor))
    config = replace(
        config, radius95_sigmas=max(config.radius95_sigmas, radius), along_factor=along
    )
    return NormalModel(config, model.weights)


def _along_factor(balls: Sequence[ReadingErrors], k: int, factor: float) -> float:
    """Share of the expected errors of slopes that has to lie along them for the heights of balls;
    all of it where too few balls tell."""
    over = [_beyond(e.height_m, BAND_SIGMAS * factor * e.spreads_m[k]) / e.along_m for e in balls]
    return radius_factor(over, SHARE, BAND_SIGMAS) / BAND_SIGMAS


def all_errors(
    model: NormalModel, presses: Iterable[KnownPress], scene: CaptureScene
) -> list[ReadingErrors]:
    """Errors of every press of which a pixel is compared."""
    return [found for press in presses if (found := errors_of(model, press, scene)) is not None]


def errors_of(
    model: NormalModel, press: KnownPress, scene: CaptureScene, read: ReadHeights | None = None
) -> ReadingErrors | None:
    """Errors of ``model`` on a press, ``read`` being what it reads there, where that is known; None
    where no pixel is compared."""
    compared = press.compared if scene.mask is None else press.compared & scene.mask
    every = EVERY_PX if read is None else 1
    part = np.s_[::every, ::every]
    kept = compared[part]
    if not kept.any():
        return None
    read = read or read_heights(
        model, press.image, scene.background, scene.grid, mask=scene.mask,
        rest_normals=scene.rest_normals, left_out=press.left_out, uncertainty=False, every=every,
    )  # fmt: skip
    found = read.normals
    angle = angle_between_deg(relative_normals(found.tilt_rad[kept]), press.normals[part][kept])
    if press.normals_sigma_deg is not None:
        angle = _beyond(angle, RAYLEIGH_95 * press.normals_sigma_deg[part][kept])
    sigmas = angle / found.sigma_deg[kept]
    grid = scene.grid.thinned(every)
    trials = [HeightUncertainty(grid, length / every) for length in LENGTHS_PX]
    weights = None if scene.mask is None else scene.mask[part].astype(float)
    slope_sigma = found.slope_sigma()
    spreads = [trial.sigma_m(slope_sigma, weights=weights, zero=read.zero) for trial in trials]
    # Over any length alike: it is smooth, and the grid of the shortest is the finest.
    along = trials[0].along_m(read.slope, slope_sigma, weights=weights, zero=read.zero)
    return ReadingErrors(
        angle_sigmas=sigmas,
        height_m=_beyond(
            np.abs(read.rise_m - press.rise_m[part])[kept],
            np.array(BAND_SIGMAS * press.rise_sigma_m),
        ),
        spreads_m=[np.maximum(spread[kept], LEAST_M) for spread in spreads],
        along_m=np.maximum(along[kept], LEAST_M),
        deepest_m=-float(press.rise_m.min()),
    )


def _beyond(error: np.ndarray, known_to: np.ndarray) -> np.ndarray:
    """What is left of errors to explain, where something independent explains ``known_to`` in 95 %:
    radii of independent errors add by their squares."""
    return np.sqrt(np.maximum(error**2 - np.square(known_to), 0.0))
