# SPDX-License-Identifier: Apache-2.0
"""Contacts of real presses against labels that nothing of the detection has seen.

How well a person labels is not known, and label - found is the scatter of both. The rim, where the
colours change fastest, is a third measurement of each circle: the covariance of found - label with
found - rim is the detection's own variance, as far as errors of the three go separate ways (F. E.
Grubbs, J. Am. Stat. Assoc. 43, 1948).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.circles.color_change import color_change, fit_rim
from taccel_lab.calibration.circles.labels import DetectedContact, circle_array, fuse_circles
from tests.calibration.circles.presses import contacts_of, offsets, press_set, pressed, scattered
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support.real_data import labelled_presses


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of centres along an axis, and of radii [px], beside common shifts."""

    found: np.ndarray
    """Of the detection, shape [2]."""
    label: np.ndarray
    stated: np.ndarray
    """Root mean square that the detection states for itself."""


def scatter_of_three(captures: CaptureSet, found: list[DetectedContact]) -> Scatter:
    """Presses whose rim or label is off by more than 6 px of the usual are mistakes."""
    label = circle_array([press.circle for press in captures.presses if press.circle is not None])
    circles, rims = circle_array([contact.circle for contact in found]), []
    for press, (u, v, radius) in zip(captures.presses, circles, strict=True):
        change = color_change(press.image(), captures.background, captures.grid, captures.mask)
        rim = fit_rim(change.change, np.array([u, v]), radius)
        rims.append((*rim.center, rim.radius))
    by_label, by_rim = circles - label, circles - np.array(rims)
    by_label, by_rim = (d - np.median(d, axis=0) for d in (by_label, by_rim))
    usual = (np.abs(by_label) < 6).all(axis=1) & (np.abs(by_rim) < 6).all(axis=1)
    assert usual.mean() > 0.9
    a, b = by_label[usual], by_rim[usual]
    of_found = np.array([np.cov(a[:, k], b[:, k])[0, 1] for k in range(3)])
    of_label = a.var(axis=0, ddof=1) - of_found
    stated = np.array([(c.center_sigma_px, c.radius_sigma_px) for c in found])[usual]

    def size(variance: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum([variance[:2].mean(), variance[2]], 0.0))

    return Scatter(size(of_found), size(of_label), np.sqrt((stated**2).mean(axis=0)))


def measured(captures: CaptureSet) -> tuple[np.ndarray, np.ndarray, Scatter]:
    """Found less labelled centres, distances of the radii [px], and whose scatter it is.

    What is stated has to cover other presses: shift and scatter of the labels are taken from one
    half of them, errors from the other.
    """
    found = contacts_of(captures)
    assert len(found) == len(captures.presses)
    given = [press.circle for press in captures.presses if press.circle is not None]
    off = offsets(captures, found)
    own = np.array([(c.center_sigma_px, c.center_sigma_px, c.radius_sigma_px) for c in found])
    covered = []
    for half in (np.arange(len(off)) % 2 == 0, np.arange(len(off)) % 2 == 1):
        picked = np.flatnonzero(half).tolist()
        center, radius = fuse_circles([given[i] for i in picked], [found[i] for i in picked])[1]
        left = off[~half] - off[half].mean(axis=0)
        covered.append(np.abs(left) < 1.96 * np.hypot(own[~half], (center, center, radius)))
    assert np.mean(np.concatenate(covered)) > 0.82
    return off[:, :2], np.abs(off[:, 2]), scatter_of_three(captures, found)


@pytest.mark.slow
def test_three_measurements_tell_whose_scatter_it_is() -> None:
    """Drawn presses, whose truth is known: noise of labels is not blamed on the detection."""
    rng = np.random.default_rng(6)
    circles = scattered(24, seed=9)
    images = [quantise(add_noise(pressed(c), 2.0, rng)) for c in circles]
    captures = press_set(circles, images)
    labelled = [
        ContactCircle(*(float(x) for x in shape + rng.normal(0, 1.5, 3)))
        for shape in circle_array(circles)
    ]
    presses = tuple(
        dataclasses.replace(press, circle=label)
        for press, label in zip(captures.presses, labelled, strict=True)
    )
    found = contacts_of(captures)
    scatter = scatter_of_three(dataclasses.replace(captures, presses=presses), found)
    true = np.std(circle_array([c.circle for c in found]) - circle_array(circles), axis=0)
    assert scatter.label == pytest.approx([1.5, 1.5], rel=0.3)
    assert true.max() < 0.3 and scatter.found.max() < 0.7


@pytest.mark.thorough
def test_gelsight_like_sensor() -> None:
    centers, radii, scatter = measured(
        labelled_presses(
            "gelsight_rvsathu_sim2real", "labels/calib_labels.csv", "background_real.png",
            2.92, 0.05926,
        )
    )  # fmt: skip
    # The labels run outside the steepest drop of colour; their radius is off by a constant.
    assert np.median(np.hypot(*centers.T)) < 1.5 and np.median(radii) < 3.5
    assert np.percentile(radii, 90) - np.median(radii) < 1.5
    assert scatter.label == pytest.approx([0.75, 0.8], rel=0.35)
    assert (scatter.found < 1.5 * scatter.stated).all()


@pytest.mark.slow
def test_gelsight_mini_with_white_balance_on() -> None:
    centers, radii, scatter = measured(
        labelled_presses("fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png", 2.35, 0.0511)
    )
    # The labels all lie to one side of where the colours turn.
    shifted = centers - np.median(centers, axis=0)
    assert np.median(np.hypot(*shifted.T)) < 3.0 and np.median(np.hypot(*centers.T)) < 4.7
    assert np.median(radii) < 2.5
    assert scatter.label == pytest.approx([1.6, 1.8], rel=0.35)
    assert (scatter.found < 1.5 * scatter.stated).all()
