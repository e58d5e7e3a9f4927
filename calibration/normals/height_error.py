# SPDX-License-Identifier: Apache-2.0
"""How far integrated heights are off, found on practice presses that the networks never saw."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.normals.cross_conformal import radius_factor
from taccel_lab.calibration.normals.practice import PracticePress
from taccel_lab.calibration.normals.samples import Scene
from taccel_lab.signals.height_uncertainty import HeightUncertainty
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.read_heights import BAND_SIGMAS, read_heights

LENGTHS_PX = (4.0, 8.0, 16.0)
"""Distances over which neighbours may err together that are tried."""
EVERY_PX = 3
"""Pixels apart that errors are looked at."""
SHARE = 0.95
DENT_MM = 0.02
"""Heights below this belong to the dent."""


@dataclass(frozen=True)
class PracticeScore:
    """Absolute errors of heights on presses of other tools."""

    rmse_mm: float
    """Over the dents, root of the mean over presses of the mean square."""
    median_press_mm: float
    """Median over presses of the root mean square in the dent."""
    worst_press_mm: float
    within_95: float
    """Share of the dents' pixels in the band of 95 %, presses of equal weight; these presses set
    the band, so that it tells how even it is, not how true."""
    count: int


@dataclass(frozen=True)
class KnownPress:
    """A press whose surface is known, and who may read it."""

    image: np.ndarray
    """RGB levels under the background's light, shape [height_px, width_px, 3]."""
    rise_m: np.ndarray
    """Rise over rest [m], shape [height_px, width_px]."""
    compared: np.ndarray
    """Pixels whose heights are compared, bool, same shape."""
    reader: NormalModel | None = None
    """Whose slopes are integrated: a part of the ensemble that did not see the press; all of it
    when None."""


def with_height_errors(
    model: NormalModel,
    practice: Iterable[PracticePress],
    balls: Iterable[KnownPress],
    scene: Scene,
) -> tuple[NormalModel, PracticeScore | None]:
    """The model with the spread of its heights, and how well it read the practice presses.

    The spread's factor is the one that holds 95 % of a new press's heights in the mean
    (cross-conformal, as for normals), on practice or on captured balls, whichever asks for more;
    the length over which errors go together is the one that does so with the narrowest band.
    """
    known = (
        KnownPress(press.image, press.rise_m, press.rise_m < -1e-3 * DENT_MM) for press in practice
    )
    drawn = [found for press in known if (found := _errors(model, press, scene)) is not None]
    if not drawn:
        return model, None
    captured = [found for press in balls if (found := _errors(model, press, scene)) is not None]
    best: tuple[float, float, float] | None = None
    for k, length in enumerate(LENGTHS_PX):
        factor = max(
            radius_factor([e / s[k] for e, s in group], SHARE, BAND_SIGMAS) / BAND_SIGMAS
            for group in (drawn, captured or drawn)
        )
        width = factor * float(np.mean([s[k].mean() for _, s in drawn]))
        if best is None or width < best[0]:
            best = (width, length, factor)
    assert best is not None
    _, length, factor = best
    k = LENGTHS_PX.index(length)
    dents = [float(1e3 * np.sqrt(np.mean(e**2))) for e, _ in drawn]
    config = replace(model.config, error_length_px=length, height_factor=factor)
    score = PracticeScore(
        rmse_mm=float(np.sqrt(np.mean(np.square(dents)))),
        median_press_mm=float(np.median(dents)),
        worst_press_mm=float(np.max(dents)),
        within_95=float(np.mean([np.mean(e <= BAND_SIGMAS * factor * s[k]) for e, s in drawn])),
        count=len(dents),
    )
    return NormalModel(config, model.weights), score


def _errors(
    model: NormalModel, press: KnownPress, scene: Scene
) -> tuple[np.ndarray, list[np.ndarray]] | None:
    """Absolute errors of the height [m] of some pixels, and their spread before any factor for each
    of ``LENGTHS_PX``; None where nothing is compared."""
    compared = press.compared if scene.mask is None else press.compared & scene.mask
    sample = (slice(None, None, EVERY_PX), slice(None, None, EVERY_PX))
    kept = compared[sample]
    if not kept.any():
        return None
    read = read_heights(
        press.reader or model, press.image, scene.background, scene.grid, mask=scene.mask,
        rest_normals=scene.rest_normals,
    )  # fmt: skip
    found = read.normals
    if press.reader is not None:
        found = model.predict(
            press.image, scene.background, mask=scene.mask, rest_normals=scene.rest_normals
        )
    spreads = []
    for length in LENGTHS_PX:
        sigma = HeightUncertainty(scene.grid, length).sigma_m(
            found.slope_sigma(),
            weights=None if scene.mask is None else scene.mask.astype(float),
            zero=read.zero,
        )
        spreads.append(np.maximum(sigma[sample][kept], 1e-9))
    return np.abs(read.rise_m - press.rise_m)[sample][kept], spreads
