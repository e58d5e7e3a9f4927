# SPDX-License-Identifier: Apache-2.0
"""Forces that a fit predicts, with the interval of all that the data leave open.

The predicted force takes the place of Young's modulus among the parameters (E = F / f(depth), f
being the force of a gel of 1 Pa) and gets a profile like any other: what first touch, Poisson's
ratio and noise leave open is in its interval, and what they share with the modulus is not counted
twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.material.indentation import IndentationFit
from taccel_lab.calibration.material.likelihood import FittedParameter, Likelihood, widened
from taccel_lab.calibration.result import NORMAL_95

FOLDS = 12
"""Most groups of points that are held out, interleaved; fewer points go one by one."""


def force_interval_n(
    fit: IndentationFit,
    index: int,
    depth_mm: float,
    *,
    recorded: bool = True,
    reading: bool = False,
) -> tuple[float, float]:
    """95 % interval of the force [N] of the tool of press ``index`` at a depth.

    Args:
        fit: Whose free parameters are varied.
        index: Of the press.
        depth_mm: Depth above 0 [mm].
        recorded: Whether the depth counts as that record counts it, whose first touch is
            uncertain; else from first touch itself, as in a simulated press.
        reading: Whether the interval is of one reading, with its noise, or of the force itself.
    """
    old, at = fit.likelihood, np.array(fit.solution.values)
    e = fit.model.names.index("ln_e")
    depth = np.array([depth_mm])

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (log,), (slopes,) = fit.model.log_force(theta, index, depth, recorded)
        inner = theta.copy()
        inner[e] = theta[e] - log
        r, jacobian = old.residuals(inner)
        return r, jacobian - np.outer(jacobian[:, e], slopes)

    middle = float(at[e] + fit.model.log_force(at, index, depth, recorded)[0][0])
    parameters = [p if p.prior_sigma is not None else replace(p, start=float(at[i]))
                  for i, p in enumerate(old.parameters)]  # fmt: skip
    parameters[e] = FittedParameter("ln_f", middle, middle - 4, middle + 4, 0.05)
    found = Likelihood(parameters, old.groups, residuals).solve(["ln_f"])
    extra = NORMAL_95 * fit.tables[index].error.interpolation
    if reading:
        force = math.exp(middle)
        extra = math.hypot(extra, old.quantile * fit.noise_n(index, force, found.noise) / force)
    low, high = widened(found.profiles["ln_f"].interval, middle, extra)
    return math.exp(low), math.exp(high)


@dataclass(frozen=True)
class HeldOut:
    """A point that was predicted from the others."""

    index: int
    """Index of its press."""
    depth_mm: float
    force_n: float
    predicted_n: float
    interval_n: tuple[float, float]
    """95 % interval of a reading there."""

    @property
    def relative(self) -> float:
        """Prediction over measurement minus 1."""
        return self.predicted_n / self.force_n - 1


Refit = Callable[[Sequence[np.ndarray]], tuple[IndentationFit, Sequence[IndentationFit]]]
"""The fit of the points that masks keep (one mask a press, bool [point]), and the fits in which all
that the data leave open is free."""


def held_out(fit: IndentationFit, refit: Refit) -> tuple[HeldOut, ...]:
    """Each point predicted from the others, or from those of other groups where there are many.

    None where a press has a single point or there are fewer than three points.
    """
    sizes = [len(item.depth_mm) for item in fit.points]
    if min(sizes) < 2 or sum(sizes) < 3:
        return ()
    folds = min(FOLDS, sum(sizes))
    owner = np.concatenate([np.full(size, i) for i, size in enumerate(sizes)])
    place = np.concatenate([np.arange(size) for size in sizes])
    found: list[HeldOut] = []
    for fold in range(folds):
        out = np.arange(len(owner)) % folds == fold
        keep = [~out[owner == i] for i in range(len(sizes))]
        if not all(mask.any() for mask in keep):
            continue
        one, free = refit(keep)
        for i, j in zip(owner[out].tolist(), place[out].tolist(), strict=True):
            depth, force = float(fit.points[i].depth_mm[j]), float(fit.points[i].force_n[j])
            ends = [force_interval_n(f, i, depth, reading=True) for f in free]
            interval = (min(low for low, _ in ends), max(high for _, high in ends))
            predicted = float(one.predicted_n(i, np.array([depth]))[0])
            found.append(HeldOut(i, depth, force, predicted, interval))
    return tuple(sorted(found, key=lambda item: (item.index, item.depth_mm)))
