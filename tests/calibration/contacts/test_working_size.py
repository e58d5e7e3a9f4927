# SPDX-License-Identifier: Apache-2.0
"""Pictures of many pixels: the same contacts, in a bounded time and memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet, Press
from taccel_lab.calibration.check.background import median_background
from taccel_lab.calibration.check.frames import measure_presses
from taccel_lab.calibration.contacts import fit
from taccel_lab.calibration.contacts.working_size import WorkingSize
from taccel_lab.geometry import PixelGrid
from tests.calibration.contacts.presses import GRID, gel, press_set, pressed, scattered


def test_lengths_shrink_with_the_picture() -> None:
    grid = PixelGrid(1920, 1440, 0.01, 0.01)
    assert WorkingSize(grid).length_px(3.0) == pytest.approx(100.0)
    assert WorkingSize(PixelGrid(640, 480, 0.03, 0.03)).length_px(3.0) == pytest.approx(100.0)


TIMES = 16
"""Pixels of a large picture, 3200 x 2400 px, along a side of one that the tests draw."""
LARGE = PixelGrid(GRID.width_px * TIMES, GRID.height_px * TIMES, GRID.mm_per_px_x / TIMES,
                  GRID.mm_per_px_y / TIMES)  # fmt: skip


def enlarged(image: np.ndarray) -> np.ndarray:
    levels = np.clip(image, 0, 255).astype(np.float32)
    size = (LARGE.width_px, LARGE.height_px)
    return cv2.resize(levels, size, interpolation=cv2.INTER_CUBIC).round().astype(np.uint8)


def large_set(count: int) -> CaptureSet:
    """Presses that are drawn when they are read."""
    small = press_set((circles := scattered(count)), [pressed(circle) for circle in circles])
    presses = tuple(
        replace(press, circle=None, read=lambda press=press: enlarged(press.read()))
        for press in small.presses
    )
    mask = np.ones((LARGE.height_px, LARGE.width_px), dtype=bool)
    return replace(small, grid=LARGE, background=enlarged(gel()), presses=presses, mask=mask)


def traced(call: Callable[[], Any]) -> tuple[Any, int]:
    tracemalloc.start()
    try:
        return call(), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_large_pictures_show_the_same_contacts() -> None:
    circles, captures = scattered(4), large_set(4)
    found, peak = traced(lambda: fit.find_contacts(captures))
    for circle, contact in zip(circles, found.contacts, strict=True):
        assert contact is not None and found.refusals == {}
        whole = ((circle.u_px + 0.5) * TIMES - 0.5, (circle.v_px + 0.5) * TIMES - 0.5)
        at = contact.circle.u_px, contact.circle.v_px
        assert np.hypot(at[0] - whole[0], at[1] - whole[1]) < 0.05 * circle.radius_px * TIMES
        assert contact.circle.radius_px == pytest.approx(circle.radius_px * TIMES, rel=0.08)
        assert 0 < contact.radius_sigma_px < 0.05 * contact.circle.radius_px
    # Drawing a picture takes two arrays of floats; the search adds less than one.
    assert peak < 350 << 20


def test_figures_of_a_large_picture_are_those_of_a_small_one() -> None:
    circles, captures = scattered(1), large_set(1)
    small = press_set(circles, [pressed(c).round().clip(0, 255).astype(np.uint8) for c in circles])
    (large,) = measure_presses(captures.presses, captures.background, captures.mask, LARGE)
    rest = gel().round().astype(np.uint8)
    (own,) = measure_presses(small.presses, rest, small.mask, GRID)
    assert large.circle is not None and own.circle is not None
    assert large.rim_px == pytest.approx(TIMES * own.rim_px, rel=0.3)
    assert large.lamps == pytest.approx(own.lamps, abs=0.15 * np.abs(own.lamps).max())


def test_pictures_that_are_not_kept_are_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    circles = scattered(6)
    small = press_set(circles, [pressed(circle) for circle in circles])
    reads: list[str] = []

    def noted(press: Press) -> Press:
        return replace(press, read=lambda: reads.append(press.name) or press.read())

    captures = replace(small, presses=tuple(map(noted, small.presses)))
    kept, once = fit.find_contacts(captures), len(reads)
    monkeypatch.setattr(fit, "KEPT_BYTES", 0)
    again = fit.find_contacts(captures)
    assert again.contacts == kept.contacts
    # In each round of the joint fit, and to judge what it found.
    assert len(reads) == 2 * once + len(circles) * (len(fit.ROUNDS) + 1)


def test_the_median_holds_no_more_than_a_band_of_large_pictures() -> None:
    captures = large_set(9)
    median, peak = traced(lambda: median_background(captures.presses))
    assert median.shape == captures.background.shape
    assert np.abs(median.astype(float) - captures.background).mean() < 1.0
    assert peak < 350 << 20


@pytest.mark.parametrize(
    ("width", "height", "factor"), [(640, 480, 1), (1919, 959, 1), (1280, 960, 2), (3264, 2449, 5)]
)
def test_circles_come_back(width: int, height: int, factor: int) -> None:
    size = WorkingSize(PixelGrid(width, height, 0.02, 0.02))
    assert size.factor == factor
    v, u = np.mgrid[:height, :width].astype(np.float32)
    small = size.picture(np.stack([u, v], axis=-1))
    assert small.shape == (size.grid.height_px, size.grid.width_px, 2)
    corner = size.whole_circle(fit.ContactCircle(0.0, 0.0, 1.0))
    assert small[0, 0] == pytest.approx([corner.u_px, corner.v_px], abs=1e-3)
    assert size.circle(corner).u_px == pytest.approx(0.0, abs=1e-9)
    mask = np.ones((height, width), dtype=bool)
    mask[factor, factor] = False
    taken = size.mask(mask)
    assert taken is not None and (taken.sum(), taken[1, 1]) == (taken.size - 1, False)
