# SPDX-License-Identifier: Apache-2.0
"""How far a force model is off on touches that it did not see, and what it takes for another
sensor's images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch

from taccel_lab.learning.force.samples import ForceSamples
from taccel_lab.learning.force.train import BATCH, BEYOND, Predictions, predictions_of
from taccel_lab.networks.force_settings import (
    ForceModelConfig,
)
from taccel_lab.reading.light import fit_light
from taccel_lab.reading.whose import unlike
from taccel_lab.with_error import NORMAL_95

OUTSIDE_SHARE = 0.005
"""Share of the validation's images that each of the two limits leaves outside."""
BINS = 4
DEPTHS_MM = (0.0, 0.25, 0.5, 0.75, 1.0, math.inf)
SHEARS = (0.0, 0.05, 0.15, 0.3, math.inf)
"""Force along the face over force along z."""
MIN_BIN = 5
"""Images that a row of a table needs."""
TOUCHED_N = 0.01


@dataclass(frozen=True)
class Errors:
    """Errors of some images; root mean squares but for the two shares."""

    name: str
    images: int
    fz_n: float
    """Error of the force along z."""
    fz_spread_n: float
    """Root mean square of that force itself: the error of who always says zero."""
    fz_relative: float
    """Median of the error over the force, of images above 0.2 N; NaN without any."""
    shear_n: float
    """Error of the force along the face, root of the sum of both components' squares."""
    shear_spread_n: float
    tz_nmm: float
    """Error of the moment about the sensor's axis through the gel's origin."""
    tilt_nmm: float
    """Error of the two moments across it, as ``shear_n``."""
    area_mm2: float
    patch_n: float
    """Error of a patch's force, all components."""
    inside95: float
    """Share of components whose error lies within 1.96 of their standard deviations."""


@dataclass(frozen=True)
class Imposters:
    """What became of images that are none of this sensor's."""

    name: str
    images: int
    outside: float
    """Share that was found."""


def errors_of(
    name: str,
    samples: ForceSamples,
    predicted: Predictions,
    config: ForceModelConfig,
    rows: np.ndarray,
) -> Errors:
    """Errors of ``rows`` (bool) against labels at the nominal modulus."""
    away = (predicted.targets - samples.targets)[rows].astype(np.float64)
    truth = samples.targets[rows].astype(np.float64)
    sigma = (predicted.sigma * np.array(config.sigma_factor))[rows]
    patches = (predicted.patches_n - samples.patches_n)[rows]
    firm = truth[:, 2] > 0.2
    relative = np.abs(away[firm, 2]) / truth[firm, 2]
    return Errors(
        name=name,
        images=int(rows.sum()),
        fz_n=_rms(away[:, 2]),
        fz_spread_n=_rms(truth[:, 2]),
        fz_relative=float(np.median(relative)) if firm.any() else math.nan,
        shear_n=_rms(np.hypot(away[:, 0], away[:, 1])),
        shear_spread_n=_rms(np.hypot(truth[:, 0], truth[:, 1])),
        tz_nmm=_rms(away[:, 5]),
        tilt_nmm=_rms(np.hypot(away[:, 3], away[:, 4])),
        area_mm2=_rms(away[:, 6]),
        patch_n=_rms(patches),
        inside95=float((np.abs(away) <= NORMAL_95 * sigma).mean()),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def tables_of(
    samples: ForceSamples, predicted: Predictions, config: ForceModelConfig
) -> dict[str, list[Errors]]:
    """Errors by depth, shear, place, motion and object; rows of too few images are left out."""
    about = samples.about
    shear = np.hypot(samples.targets[:, 0], samples.targets[:, 1])
    ratio = shear / np.maximum(samples.targets[:, 2], TOUCHED_N)
    touched = samples.targets[:, 2] > TOUCHED_N

    def row(name: str, rows: np.ndarray) -> list[Errors]:
        rows = rows & touched
        return [errors_of(name, samples, predicted, config, rows)] if rows.sum() >= MIN_BIN else []

    def bins(values: np.ndarray, edges: Sequence[float], unit: str) -> list[Errors]:
        found = []
        for low, high in pairwise(edges):
            name = f"{low:.3g} to {high:.3g}" if high < math.inf else f"above {low:.3g}"
            # Depths of steps are sums of parts: 0.5000000001 is 0.5.
            found += row(f"{name} {unit}".strip(), (values > low + 1e-6) & (values <= high + 1e-6))
        return found

    def each(name: str) -> list[Errors]:
        values = about[name]
        return [e for v in sorted(set(values.tolist())) for e in row(str(v), values == v)]

    places = np.quantile(about["off_center_mm"], np.linspace(0, 1, BINS + 1))
    places[0] = 0.0
    return {
        "depth": bins(about["depth_mm"], DEPTHS_MM, "mm"),
        "shear": bins(np.maximum(ratio, 2e-6), SHEARS, ""),
        "place": bins(np.maximum(about["off_center_mm"], 2e-6), places.tolist(), "mm"),
        "motion": each("motion"),
        "object": each("object"),
        "unit": each("unit"),
    }


def sigma_factors(samples: ForceSamples, predicted: Predictions) -> tuple[float, ...]:
    """Factors that put 95 % of each component's errors within 1.96 standard deviations."""
    over = np.abs(predicted.targets - samples.targets) / np.maximum(predicted.sigma, 1e-12)
    return tuple(
        max(float(value) / NORMAL_95, 1e-3) for value in np.quantile(over.astype(float), 0.95, 0)
    )


def limits_of(predicted: Predictions) -> tuple[float, ...]:
    """Distances that all but ``OUTSIDE_SHARE`` of the images stay below; colours may go a little
    beyond the training's in any case."""
    least = (1e-6, 1e-6, BEYOND)
    found = np.quantile(predicted.distances.astype(float), 1 - OUTSIDE_SHARE, axis=0)
    return tuple(max(float(value), low) for value, low in zip(found, least, strict=True))


def outside_rows(predicted: Predictions, config: ForceModelConfig) -> np.ndarray:
    """Which images are outside, bool, [step]; as ``ForceModel`` judges."""
    far = (predicted.distances > np.array(config.distance_limits)).any(axis=1)
    shear = np.hypot(predicted.targets[:, 0], predicted.targets[:, 1])
    patch = predicted.patches_n[:, 2].max(axis=(1, 2))
    reached = np.column_stack([predicted.targets[:, 2], shear, predicted.targets[:, 6], patch])
    return np.asarray(far | (reached > np.array(config.most)).any(axis=1))


def found_imposters(
    samples: ForceSamples,
    config: ForceModelConfig,
    weights: dict[str, np.ndarray],
    centers_mm: np.ndarray,
    seed: int,
) -> list[Imposters]:
    """Images made of held-out ones that a user may give by mistake, and how many are found, by the
    model or, before it, by what ``ForceReader`` asks of any image (``FrameJudge``).

    Markers, where the network sees them, stay as they are: only the image is wrong.
    """
    rows = np.flatnonzero(samples.targets[:, 2] > TOUCHED_N)[:1024]
    rest = torch.from_numpy(samples.rest[samples.touch[rows]].astype(np.float32))
    image = torch.from_numpy(samples.change[rows].astype(np.float32)) + rest
    generator = torch.Generator().manual_seed(seed)
    made: dict[str, Callable[[], torch.Tensor]] = {
        "black frame": lambda: torch.zeros_like(image),
        "white frame": lambda: torch.full_like(image, 255.0),
        "noise": lambda: torch.rand(image.shape, generator=generator) * 255,
        "red and blue swapped": lambda: image.flip(1),
        "turned by half": lambda: image.flip(2).flip(3),
        "another light: gain 1.5": lambda: (1.5 * image).clamp(0, 255),
        "change of colour inverted": lambda: (2 * rest - image).clamp(0, 255),
        "change of colour doubled": lambda: (2 * image - rest).clamp(0, 255),
    }
    tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
    centers = torch.from_numpy(centers_mm.astype(np.float32))
    moved = None if samples.moved is None else torch.from_numpy(samples.moved[rows])
    found = []
    for name, make in made.items():
        shown, outside = make(), []
        change = shown - rest
        for start in range(0, len(rows), BATCH):
            part = slice(start, start + BATCH)
            with torch.no_grad():
                predicted = predictions_of(
                    change[part], None if moved is None else moved[part], config, tensors, centers
                )
            arrays = {key: value.numpy() for key, value in predicted.items()}
            outside.append(outside_rows(Predictions.of(arrays), config))
        noticed = np.concatenate(outside)
        for row in np.flatnonzero(~noticed).tolist():
            levels, untouched = (a[row].permute(1, 2, 0).numpy() for a in (shown, rest))
            light = fit_light(levels, untouched, gradient=False)
            noticed[row] = unlike(levels, untouched, light) is not None
        found.append(Imposters(name, len(rows), float(noticed.mean())))
    return found


def as_json(found: Errors | Imposters) -> dict[str, Any]:
    """Figures, None for what is not known."""
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in asdict(found).items()
    }
