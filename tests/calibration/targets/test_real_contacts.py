# SPDX-License-Identifier: Apache-2.0
"""Contacts of real presses against labels that nothing of the detection has seen."""

from __future__ import annotations

import csv
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calibration.capture import CaptureSet, ContactCircle, Press
from calibration.capture.images import read_image
from calibration.targets import find_contacts
from calibration.targets.agreement import LabelAgreement, agreement
from taccel_lab.geometry import PixelGrid

DATA = Path(
    os.environ.get("TACCEL_LAB_DATA", Path(__file__).resolve().parents[4] / "shared" / "data")
)


def labelled(
    folder: str, labels: str, background: str, mm_per_px: float, ball_mm: float, every: int
) -> CaptureSet:
    root = DATA / folder
    if not (root / labels).is_file():
        pytest.skip(f"{root / labels} is not there")
    image = read_image(root / background)
    with (root / labels).open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))[::every]
    keys = ("cx_px", "cy_px", "contact_r_px")
    presses = tuple(
        Press(
            row["file"], row["file"], "0" * 64,
            ContactCircle(*(float(row[key]) for key in keys)),
            partial(read_image, root / row["file"]),
        )
        for row in rows
    )  # fmt: skip
    grid = PixelGrid(image.shape[1], image.shape[0], mm_per_px, mm_per_px)
    usable = np.ones(image.shape[:2], dtype=bool)
    return CaptureSet(folder, "gelsight", image, "0" * 64, usable, ball_mm, grid, presses, {})


def measured(captures: CaptureSet, label_sigma_px: float) -> LabelAgreement:
    """Agreement with labels; errors beside a common shift have to be what is stated for them.

    ``label_sigma_px`` is how well a person sets a label, along each axis and in radius.
    """
    found = find_contacts(captures)
    assert not found.refusals
    off, sigma = [], []
    for press, contact in zip(captures.presses, found.contacts, strict=True):
        assert press.circle is not None and contact is not None
        a, b = press.circle, contact.circle
        off.append((b.u_px - a.u_px, b.v_px - a.v_px, b.radius_px - a.radius_px))
        sigma.append((contact.center_sigma_px,) * 2 + (contact.radius_sigma_px,))
    beside = np.array(off) - np.median(off, axis=0)
    standardised = beside / np.hypot(sigma, label_sigma_px)
    assert 0.5 < np.sqrt(np.mean(standardised**2)) < 1.6
    result = agreement(
        [press.circle for press in captures.presses],
        [None if contact is None else contact.circle for contact in found.contacts],
    )
    assert result is not None
    return result


def test_gelsight_like_sensor() -> None:
    result = measured(
        labelled(
            "gelsight_rvsathu_sim2real", "labels/calib_labels.csv", "background_real.png",
            0.05926, 2.92, 2,
        ),
        0.6,
    )  # fmt: skip
    # The labels run outside the steepest drop of colour; their radius is off by a constant.
    assert result.center_median_px < 2.0 and result.radius_median_px < 3.5
    assert result.radius_p90_px - result.radius_median_px < 1.5


def test_gelsight_mini_with_white_balance_on() -> None:
    result = measured(
        labelled("fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png", 0.0511, 2.35, 2),
        1.0,
    )
    # The labels all lie to one side of where the colours turn.
    assert result.center_median_shifted_px < 3.0 and result.center_median_px < 4.7
    assert result.radius_median_px < 2.5
