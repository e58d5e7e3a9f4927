# SPDX-License-Identifier: Apache-2.0
"""How far circles move when the model that found them is another one that is as likely.

Residuals of one fit say what noise does. They do not say what the model cannot follow: a map with
too few terms, a channel whose light is no polynomial, a gel that sinks beside the ball otherwise
than the law says. All of that moves circles without leaving larger residuals, so that it is tried:

- one power more of everything in the map: what the series still moves where it is cut off (one
  power less says what it has moved already, on a gel of many colours three times as much);
- without each of the channels in turn (the jackknife, B. Efron, The Jackknife, the Bootstrap and
  Other Resampling Plans, 1982, eq. 3.6);
- with a sink-in of ``OTHER_SINK_IN_SCALE``, the most that the colours of real presses ask for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from taccel_lab.calibration.circles.joint_fit import PhotometricFit, RingSamples, fit_contacts
from taccel_lab.calibration.circles.labels import circle_array
from taccel_lab.calibration.circles.press_model import SINK_IN_SCALE, MapTerms

OTHER_SINK_IN_SCALE = 2.0
OTHER_ROUNDS = 12
"""Rounds of Gauss-Newton at most: where colours say little of a radius, it moves slowly."""
SETTLED = 0.5
"""Share of the presses whose circles rest then: typical ones say what a model moves."""
MIN_SIGMA_PX = 0.05
"""Resampling moves circles of perfect presses by that much."""
CHANNELS = 3


def circle_covariances(
    samples: Sequence[RingSamples], ball_px: Sequence[float], fit: PhotometricFit
) -> list[np.ndarray]:
    """Covariance of u, v and radius of each press [px^2], shape [3, 3].

    The larger of what the residuals say and what leaving out channels does, as both hold the noise,
    plus what map and sink-in do. A press tells little about its own doubt, so that half of what a
    channel moves, and all of what map and sink-in do, are typical values (medians) over presses.
    """
    start = circle_array([contact.circle for contact in fit.contacts])

    def moved(
        samples: Sequence[RingSamples],
        before: PhotometricFit = fit,
        terms: MapTerms = fit.terms,
        sink_in: float = SINK_IN_SCALE,
    ) -> np.ndarray:
        other = fit_contacts(
            samples, before, ball_px, terms=terms, iterations=OTHER_ROUNDS, sink_in=sink_in,
            settled=SETTLED,
        )  # fmt: skip
        return circle_array([contact.circle for contact in other.contacts]) - start

    def moved_without(channel: int) -> np.ndarray:
        """A channel that is zero everywhere has no say: the map of it is zero as well."""
        kept = np.arange(CHANNELS) != channel
        before = replace(fit, map=fit.map * kept[:, None], offsets=fit.offsets * kept)
        return moved([replace(one, change=one.change * kept) for one in samples], before)

    finer = 1.4826 * _typical(moved(samples, terms=fit.terms.finer()))
    sink_in = _typical(moved(samples, sink_in=OTHER_SINK_IN_SCALE))
    without = np.stack([moved_without(channel) for channel in range(CHANNELS)])
    channels = ((without - without.mean(axis=0)) ** 2).sum(axis=0) * (CHANNELS - 1) / CHANNELS
    channels[:, :2] = channels[:, :2].mean(axis=1, keepdims=True)
    channels = (channels + np.median(channels, axis=0)) / 2
    common = finer**2 + sink_in**2 + MIN_SIGMA_PX**2
    covariances = []
    for contact, own in zip(fit.contacts, channels, strict=True):
        # Its correlations are kept: the residuals' covariance is scaled along u, v and radius.
        variance = np.diag(contact.covariance)
        wider = np.sqrt(np.maximum(own, variance) / np.maximum(variance, 1e-12))
        covariances.append(contact.covariance * np.outer(wider, wider) + np.diag(common))
    return covariances


def _typical(moved: np.ndarray) -> np.ndarray:
    """Median distance moved along u and v, one value for both, and in radius, shape [3]."""
    center = float(np.median(np.abs(moved[:, :2])))
    return np.array([center, center, float(np.median(np.abs(moved[:, 2])))])
