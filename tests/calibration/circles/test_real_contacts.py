# SPDX-License-Identifier: Apache-2.0
"""Contacts of real presses against labels that nothing of the detection has seen.

How well a person labels is not known, and label - found is the scatter of both. The rim, where the
colours change fastest, is a third measurement of each circle: the covariance of found - label with
found - rim is the detection's own variance, as far as errors of the three go separate ways (F. E.
Grubbs, J. Am. Stat. Assoc. 43, 1948).
"""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.circles.color_change import color_change, fit_rim
from taccel_lab.calibration.circles.labels import circle_array, fuse_circles
from tests.calibration.circles.presses import contacts_of, offsets
from tests.support.real_data import labelled_presses
from tests.support.synthetic_presses import circles_of


def measured(captures: CaptureSet, label_px: tuple[float, float]) -> np.ndarray:
    """Found less labelled circles [n, 3]; labels scatter by ``label_px`` (centres along an axis,
    radii), the detection by little more than it states, which covers the errors."""
    found, labels = contacts_of(captures), circles_of(captures)
    off, circles = offsets(captures, found), circle_array([contact.circle for contact in found])
    assert len(off) == len(captures.presses)
    own = np.array([(c.center_sigma_px, c.center_sigma_px, c.radius_sigma_px) for c in found])
    # It has to cover other presses: shift and scatter of the labels are taken from one half of
    # them, errors from the other.
    covered = []
    for half in (np.arange(len(off)) % 2 == 0, np.arange(len(off)) % 2 == 1):
        picked = np.flatnonzero(half).tolist()
        center, radius = fuse_circles([labels[i] for i in picked], [found[i] for i in picked])[1]
        left = off[~half] - off[half].mean(axis=0)
        covered.append(np.abs(left) < 1.96 * np.hypot(own[~half], (center, center, radius)))
    assert np.mean(np.concatenate(covered)) > 0.82
    rims = []
    for press, (u, v, radius) in zip(captures.presses, circles, strict=True):
        change = color_change(press.image(), captures.background, captures.grid, captures.mask)
        rim = fit_rim(change.change, np.array([u, v]), radius)
        rims.append((*rim.center, rim.radius))
    # Presses whose rim or label is off by more than 6 px of the usual are mistakes.
    by_label, by_rim = (d - np.median(d, axis=0) for d in (off, circles - np.array(rims)))
    usual = (np.abs(by_label) < 6).all(axis=1) & (np.abs(by_rim) < 6).all(axis=1)
    assert usual.mean() > 0.9
    a, b = by_label[usual], by_rim[usual]
    of_found = np.array([np.cov(a[:, k], b[:, k])[0, 1] for k in range(3)])

    def size(variance: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum([variance[:2].mean(), variance[2]], 0.0))

    stated = np.sqrt((own[usual][:, 1:] ** 2).mean(axis=0))
    assert (size(of_found) < 1.5 * stated).all()
    assert size(a.var(axis=0, ddof=1) - of_found) == pytest.approx(label_px, rel=0.35)
    return off


@pytest.mark.thorough
def test_gelsight_like_sensor() -> None:
    captures = labelled_presses(
        "gelsight_rvsathu_sim2real", "labels/calib_labels.csv", "background_real.png", 2.92, 0.05926
    )
    off = measured(captures, (0.75, 0.8))
    # The labels run outside the steepest drop of colour; their radius is off by a constant.
    radii = np.abs(off[:, 2])
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 1.5 and np.median(radii) < 3.5
    assert np.percentile(radii, 90) - np.median(radii) < 1.5


@pytest.mark.slow
def test_gelsight_mini_with_white_balance_on() -> None:
    captures = labelled_presses(
        "fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png", 2.35, 0.0511
    )
    off = measured(captures, (1.6, 1.8))
    # The labels all lie to one side of where the colours turn.
    shifted = off - np.median(off, axis=0)
    assert np.median(np.hypot(shifted[:, 0], shifted[:, 1])) < 3.0
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 4.7 and np.median(np.abs(off[:, 2])) < 2.5
