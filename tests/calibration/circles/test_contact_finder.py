# SPDX-License-Identifier: Apache-2.0
"""Contacts found in images, and the sizes they are looked for in."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from taccel_lab.calibration.capture import CapturedPress, CaptureSet, ContactCircle
from taccel_lab.calibration.check.background import median_background
from taccel_lab.calibration.check.frames import measure_presses
from taccel_lab.calibration.circles import contact_finder
from taccel_lab.calibration.circles.color_change import WorkingSize, fit_circle
from taccel_lab.calibration.circles.contact_finder import detect_contact
from taccel_lab.calibration.circles.labels import DetectedContact
from taccel_lab.calibration.circles.press_model import SINK_IN_SCALE, hertz_slope, slope_law
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from tests.calibration.circles import presses
from tests.calibration.circles.presses import GRID, contacts_of, gel, offsets, pressed, scattered
from tests.calibration.drawn import faults
from tests.calibration.drawn.faults import add_noise, quantise
from tests.support import synthetic_presses as plain


def in_sigmas(captures: CaptureSet, contacts: Sequence[DetectedContact]) -> np.ndarray:
    """Offsets in the standard deviations that the contacts state."""
    sigmas = [(c.center_sigma_px, c.center_sigma_px, c.radius_sigma_px) for c in contacts]
    return offsets(captures, contacts) / np.array(sigmas)


@pytest.mark.thorough(cases=("perfect",))
@pytest.mark.parametrize(
    ("grid", "count", "left_px"),
    [(GRID, 12, 0.1), (PixelGrid(200, 120, 0.08, 0.1), 4, 0.25)],
    ids=["perfect", "oblong pixels"],
)
def test_presses_without_noise(grid: PixelGrid, count: int, left_px: float) -> None:
    circles = scattered(count, seed=0 if grid is GRID else 3, grid=grid)
    captures = presses.press_set(circles, [pressed(c, grid) for c in circles], grid)
    assert np.abs(offsets(captures, contacts_of(captures))).max() < left_px


def faulty(
    circle: ContactCircle, rng: np.random.Generator, sink_in: float = SINK_IN_SCALE
) -> np.ndarray:
    """Blurred, unevenly lit, drifted, dusty, noisy, in whole levels."""
    image = faults.vignette(faults.blur(pressed(circle, sink_in=sink_in), 1.0), 0.1)
    image = faults.drift(image, 1 + rng.normal(0, 0.04, 3), rng.normal(0, 4, 3))
    image = faults.add_gradient(image, float(rng.normal(0, 2)), float(rng.normal(0, 2)))
    image = faults.add_dust(image, 10, rng, radius_px=1.5)
    return quantise(add_noise(image, 2.0, rng))


@pytest.mark.thorough
def test_faulty_presses_within_their_own_sigma() -> None:
    rng = np.random.default_rng(1)
    circles = scattered(9, seed=5)
    captures = presses.press_set(circles, [faulty(c, rng) for c in circles])
    contacts = contacts_of(captures)
    off = offsets(captures, contacts)
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.35 and np.abs(off).max() < 2.0
    centers, radii = np.split(in_sigmas(captures, contacts), [2], axis=1)
    # Robust spread of the normalised errors: 1 when the predicted sigma is right.
    assert 0.4 < 1.4826 * np.median(np.abs(centers)) < 2.0
    assert 0.3 < 1.4826 * np.median(np.abs(radii)) < 2.5


@pytest.mark.thorough
def test_sigma_holds_what_the_law_of_the_gel_may_be_wrong_by() -> None:
    """Gels that sink over shorter and longer ways than the law says: radii are off together."""
    scores = []
    for seed, sink_in in enumerate((0.9, 2.0)):
        rng = np.random.default_rng(seed)
        circles = scattered(5, seed=20 + seed)
        captures = presses.press_set(circles, [faulty(c, rng, sink_in) for c in circles])
        scores.append(in_sigmas(captures, contacts_of(captures)))
    for standardised in np.split(np.concatenate(scores), [2], axis=1):
        assert 0.4 < np.sqrt(np.mean(standardised**2)) < 1.5


def assert_near(
    found: DetectedContact, circle: ContactCircle, center_px: float, radius_px: float = np.inf
) -> None:
    off = found.circle.u_px - circle.u_px, found.circle.v_px - circle.v_px
    assert np.hypot(*off) < center_px
    assert abs(found.circle.radius_px - circle.radius_px) < radius_px


@settings(max_examples=4, deadline=None)
@given(u=st.floats(45, 155), v=st.floats(45, 105), radius=st.floats(19, 25), seed=st.integers(0, 9))
def test_a_single_press(u: float, v: float, radius: float, seed: int) -> None:
    circle = ContactCircle(u, v, radius)
    image = faulty(circle, np.random.default_rng(seed))
    found = detect_contact(image, gel(), GRID, ball_radius_mm=presses.BALL_MM)
    assert_near(found, circle, 1.5, 2.0)
    assert found.confidence > 0.7


@pytest.mark.thorough
@settings(max_examples=5)
@given(u=st.floats(30, 130), v=st.floats(30, 90), radius=st.floats(11, 17), seed=st.integers(0, 99))
def test_a_single_press_of_another_law(u: float, v: float, radius: float, seed: int) -> None:
    circle = ContactCircle(u, v, radius)
    image, _ = plain.press_image(circle, np.random.default_rng(seed), noise=2.0)
    assert_near(detect_contact(image, plain.flat_background(), plain.GRID), circle, 1.0, 2.0)


def test_grey_dark_and_small() -> None:
    circle = ContactCircle(80.0, 70.0, 9.0)
    rng = np.random.default_rng(0)
    dark = quantise(add_noise(0.25 * pressed(circle, ball_px=12.5), 0.5, rng))
    assert_near(detect_contact(dark, 0.25 * gel(), GRID, ball_radius_mm=1.0), circle, 1.0)
    # A grey sensor darkens with depth; the slope does not show.
    circle = ContactCircle(100.0, 75.0, 22.0)
    _, drop = slope_law(circle.distance_px(GRID), 22.0, 30.0, 1.0, 200.0)[0]
    dent = np.repeat((120 * (drop - drop.min()))[..., None], 3, axis=-1)
    dented = quantise(add_noise(150.0 - dent, 1.0, rng))
    found = detect_contact(dented, np.full_like(dent, 150.0), GRID, ball_radius_mm=2.4)
    # How a grey sensor answers to depth is not known, and the rim is where the slope ends.
    assert_near(found, circle, 1.0, 2 * found.radius_sigma_px)
    assert found.confidence < 0.5


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("share", "left_px"), [pytest.param(0.25, 1.5, marks=pytest.mark.slow), (1 / 3, 3.0)]
)
def test_contacts_that_fill_the_picture(share: float, left_px: float) -> None:
    """Contact and sunk gel are most of the picture: they decide neither its light nor its noise."""
    grid, rng = PixelGrid(120, 90, 0.08, 0.08), np.random.default_rng(3)
    radius = share * grid.height_px
    places = rng.uniform(np.full(2, radius + 3), np.array([116, 86]) - radius, (8, 2))
    circles = [ContactCircle(u, v, radius) for u, v in places.tolist()]
    images = []
    for circle in circles:
        clean = pressed(circle, grid, ball_px=1.3 * radius)
        lit = faults.drift(clean, rng.uniform(0.95, 1.05, 3), rng.uniform(-8, 8, 3))
        images.append(quantise(add_noise(lit, 1.5, rng)))
    captures = presses.press_set(circles, images, grid)
    captures = replace(captures, ball_radius_mm=1.3 * radius * grid.mm_per_px_x)
    assert np.abs(offsets(captures, contacts_of(captures))).max() < left_px


def test_dots_that_move_with_the_gel() -> None:
    circle = ContactCircle(100.0, 75.0, 22.0)
    at_rest, moved = gel(), pressed(circle)
    v, u = np.mgrid[:150, :200]
    for x in range(12, 200, 18):
        for y in range(12, 150, 18):
            out = np.array([x, y], float) - [circle.u_px, circle.v_px]
            push = 3.0 * out / max(np.hypot(*out), 8.0) * np.exp(-np.hypot(*out) / 30)
            at_rest -= 60 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8)[..., None]
            moved -= 60 * np.exp(-((u - x - push[0]) ** 2 + (v - y - push[1]) ** 2) / 8)[..., None]
    image = quantise(add_noise(moved, 1.0, np.random.default_rng(4)))
    found = detect_contact(image, at_rest, GRID, ball_radius_mm=presses.BALL_MM)
    assert_near(found, circle, 2.5, 3.5)


@pytest.mark.thorough
def test_poisoned_pixels_have_no_effect() -> None:
    rng = np.random.default_rng(2)
    circles = scattered(3, seed=8)
    clean = [faulty(c, rng) for c in circles]
    mask = np.ones((150, 200), dtype=bool)
    mask[5:30, 120:190] = False
    mask[::17, ::13] = False
    poisoned = [quantise(faults.poison(image, mask, rng)) for image in clean]
    one, two = (
        contacts_of(replace(presses.press_set(circles, images), mask=mask))
        for images in (clean, poisoned)
    )
    assert one == two


@given(contact=st.floats(5, 28), blur_px=st.floats(0, 3))
def test_slope_law(contact: float, blur_px: float) -> None:
    distance = np.linspace(0.0, 119.9, 400)
    normal, drop = slope_law(distance, contact, 30.0, blur_px, 120.0)[0]
    assert (normal >= -1e-12).all() and (normal < 1).all()
    assert (np.diff(drop) <= 1e-12).all()
    middle = distance < contact - 4 * blur_px - 1
    assert normal[middle] == pytest.approx(distance[middle] / 30.0, abs=1e-9)
    assert normal[-1] < 0.12


def test_hertz_slope_is_johnsons_derivative() -> None:
    def sunk(x: np.ndarray) -> np.ndarray:
        return (2 - x**2) * np.arcsin(1 / x) + np.sqrt(x**2 - 1)

    ratio, step = np.linspace(1.01, 4, 50), 1e-6
    slope = -(sunk(ratio + step) - sunk(ratio - step)) / (2 * step)
    assert hertz_slope(ratio) == pytest.approx(slope / np.pi, rel=1e-6)
    assert hertz_slope(np.array([1.0])) == pytest.approx(1.0)


@given(
    x=st.floats(-500, 500), y=st.floats(-500, 500), radius=st.floats(5, 200),
    outliers=st.integers(0, 30), seed=st.integers(0, 50),
)  # fmt: skip
def test_circle_and_outliers(x: float, y: float, radius: float, outliers: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.r_[np.linspace(0, 2 * np.pi, 61)[:-1], rng.uniform(0, 2 * np.pi, outliers)]
    away = radius * np.r_[np.ones(60), rng.uniform(1.5, 3.0, outliers)]
    points = np.column_stack([x + away * np.cos(turn), y + away * np.sin(turn)])
    # A guess as rough as the first circles of presses.
    start = np.array([x, y]) + 0.15 * radius * rng.uniform(-1, 1, 2)
    fit = fit_circle(points, start, radius * rng.uniform(0.85, 1.15), tolerance=0.05 * radius)
    assert fit.center == pytest.approx([x, y], abs=1e-6 * max(radius, abs(x), abs(y)))
    assert fit.radius == pytest.approx(radius, rel=1e-6)
    assert fit.inliers.tolist() == [True] * 60 + [False] * outliers


def test_what_is_no_ball_is_refused() -> None:
    rest, rng = plain.flat_background(), np.random.default_rng(1)
    drifted = add_noise(rest + [9.0, -4.0, 6.0], 2.0, rng)
    with pytest.raises(InputError, match=r"empty\.png: no contact found.*give its circle"):
        detect_contact(drifted, rest, plain.GRID, name="empty.png")
    edge = rest.copy()
    edge[:, 80:84] += 60.0
    edge = gaussian_filter(edge, (0, 1.5, 0))  # As a lens shows it.
    with pytest.raises(InputError, match=r"edge\.png: no round contact found"):
        detect_contact(edge, rest, plain.GRID, name="edge.png")


@pytest.mark.thorough
@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_real_presses(taxim_captures: CaptureSet, every: int) -> None:
    some = taxim_captures.only(range(0, 48, every))
    # Labels are clicked by hand: even pixels, odd radii; 3 px are 0.09 mm.
    off = offsets(some, contacts_of(some))
    assert len(off) == 48 // every
    center, radius = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    assert np.median(center) < 2.2 and np.percentile(center, 90) < 4.5
    assert np.median(radius) < 1.8 and np.percentile(radius, 90) < 3.3


def test_real_background_is_refused(taxim_captures: CaptureSet) -> None:
    with pytest.raises(InputError, match="no contact found"):
        detect_contact(taxim_captures.background, taxim_captures.background, taxim_captures.grid)


TIMES = 16
"""Pixels of a large picture, 3200 x 2400 px, along a side of one that the tests draw."""
LARGE = PixelGrid(GRID.width_px * TIMES, GRID.height_px * TIMES, GRID.mm_per_px_x / TIMES,
                  GRID.mm_per_px_y / TIMES)  # fmt: skip


def enlarged(image: np.ndarray) -> np.ndarray:
    levels, size = np.clip(image, 0, 255).astype(np.float32), (LARGE.width_px, LARGE.height_px)
    return cv2.resize(levels, size, interpolation=cv2.INTER_CUBIC).round().astype(np.uint8)


def large_set(count: int) -> CaptureSet:
    """Presses that are drawn when they are read."""
    circles = scattered(count)
    small = presses.press_set(circles, [pressed(circle) for circle in circles])
    drawn = tuple(
        replace(press, circle=None, read=lambda press=press: enlarged(press.read()))
        for press in small.presses
    )
    mask = np.ones((LARGE.height_px, LARGE.width_px), dtype=bool)
    return replace(small, grid=LARGE, background=enlarged(gel()), presses=drawn, mask=mask)


def traced(call: Callable[[], Any]) -> Any:
    """What ``call`` returns; drawing takes two arrays of floats, the rest less than one."""
    tracemalloc.start()
    try:
        found = call()
        assert tracemalloc.get_traced_memory()[1] < 350 << 20
    finally:
        tracemalloc.stop()
    return found


@pytest.mark.thorough
def test_large_pictures_show_the_same_contacts() -> None:
    circles, captures = scattered(2), large_set(2)
    found = traced(lambda: contact_finder.find_contacts(captures))
    for circle, contact in zip(circles, found, strict=True):
        u_px, v_px = (TIMES * (x + 0.5) - 0.5 for x in (circle.u_px, circle.v_px))
        whole = ContactCircle(u_px, v_px, TIMES * circle.radius_px)
        assert isinstance(contact, DetectedContact)
        assert_near(contact, whole, 0.05 * whole.radius_px, 0.08 * whole.radius_px)
        assert 0 < contact.radius_sigma_px < 0.05 * contact.circle.radius_px


@pytest.mark.thorough
def test_figures_of_a_large_picture_are_those_of_a_small_one() -> None:
    circles, captures = scattered(1), large_set(1)
    small = presses.press_set(circles, [quantise(pressed(c)) for c in circles])
    (large,) = measure_presses(captures.presses, captures.background, captures.mask, LARGE)
    (own,) = measure_presses(small.presses, quantise(gel()), small.mask, GRID)
    assert large.circle is not None and own.circle is not None
    assert large.rim_px == pytest.approx(TIMES * own.rim_px, rel=0.3)
    assert large.lamps == pytest.approx(own.lamps, abs=0.15 * np.abs(own.lamps).max())


def test_pictures_that_are_not_kept_are_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    circles = scattered(3)
    small = presses.press_set(circles, [pressed(circle) for circle in circles])
    reads: list[str] = []

    def noted(press: CapturedPress) -> CapturedPress:
        return replace(press, read=lambda: reads.append(press.name) or press.read())

    captures = replace(small, presses=tuple(map(noted, small.presses)))
    kept, once = contact_finder.find_contacts(captures), len(reads)
    monkeypatch.setattr(contact_finder, "KEPT_BYTES", 0)
    assert contact_finder.find_contacts(captures) == kept
    # To be weighed, in each round of the joint fit, and to judge what it found; where the search
    # starts is known from before.
    assert len(reads) == once + len(circles) * (1 + len(contact_finder.ROUNDS) + 1)


@pytest.mark.thorough
def test_the_median_holds_no_more_than_a_band_of_large_pictures() -> None:
    captures = large_set(9)
    median = traced(lambda: median_background(captures.presses))
    assert median.shape == captures.background.shape
    assert np.abs(median.astype(float) - captures.background).mean() < 1.0


@pytest.mark.thorough(cases=("3264-2449-5",))
@pytest.mark.parametrize(
    ("width", "height", "factor"), [(640, 480, 1), (1919, 959, 1), (1280, 960, 2), (3264, 2449, 5)]
)
def test_circles_come_back(width: int, height: int, factor: int) -> None:
    size = WorkingSize(PixelGrid(width, height, 0.02, 0.02))
    assert size.factor == factor
    assert size.length_px(3.0) == pytest.approx(150.0 / factor)
    v, u = np.mgrid[:height, :width].astype(np.float32)
    small = size.picture(np.stack([u, v], axis=-1))
    assert small.shape == (size.grid.height_px, size.grid.width_px, 2)
    corner = size.whole_circle(ContactCircle(0.0, 0.0, 1.0))
    assert small[0, 0] == pytest.approx([corner.u_px, corner.v_px], abs=1e-3)
    assert size.circle(corner).u_px == pytest.approx(0.0, abs=1e-9)
    mask = np.ones((height, width), dtype=bool)
    mask[factor, factor] = False
    taken = size.mask(mask)
    assert taken is not None and (taken.sum(), taken[1, 1]) == (taken.size - 1, False)
