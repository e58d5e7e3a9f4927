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

from taccel_lab.calibration.contacts.circle_arrays import circle_array
from taccel_lab.calibration.contacts.photometric import MapTerms, PhotometricFit, fit_contacts
from taccel_lab.calibration.contacts.rings import RingSamples

OTHER_SINK_IN_SCALE = 2.0
OTHER_ROUNDS = 5
"""Rounds of Gauss-Newton from circles that are nearly right."""
MIN_SIGMA_PX = 0.05
"""Resampling moves circles of perfect presses by that much."""
CHANNELS = 3


def circle_covariances(
    samples: Sequence[RingSamples],
    ball_px: Sequence[float],
    fit: PhotometricFit,
    terms: MapTerms,
) -> list[np.ndarray]:
    """Covariance of u, v and radius of each press [px^2], shape [3, 3].

    The larger of what the residuals say and what leaving out channels does, as both hold the noise,
    plus what map and sink-in do. A press tells little about its own doubt, so that half of what a
    channel moves, and all of what map and sink-in do, are typical values (medians) over presses.
    """
    circles = [contact.circle for contact in fit.contacts]
    start = circle_array(circles)

    def moved(
        samples: Sequence[RingSamples],
        terms: MapTerms,
        sink_in: float | None = None,
    ) -> np.ndarray:
        other = fit_contacts(
            samples, circles, ball_px, blur_px=fit.blur_px, terms=terms, iterations=OTHER_ROUNDS,
            sink_in=sink_in,
        )  # fmt: skip
        return circle_array([contact.circle for contact in other.contacts]) - start

    finer = 1.4826 * _typical(moved(samples, terms.finer()))
    sink_in = _typical(moved(samples, terms, OTHER_SINK_IN_SCALE))
    without = np.stack([moved([_without(s, c) for s in samples], terms) for c in range(CHANNELS)])
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


def _without(samples: RingSamples, channel: int) -> RingSamples:
    """A channel that is zero everywhere has no say: the map of it is zero as well."""
    return replace(samples, change=np.where(np.arange(CHANNELS) == channel, 0.0, samples.change))
