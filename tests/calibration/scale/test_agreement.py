# SPDX-License-Identifier: Apache-2.0
"""Scales of pressed edges and of other kinds; those that agree are averaged, others told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle, Frame
from taccel_lab.calibration.capture.folder import EdgeCapture
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import EdgeEntry, LineEntry
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.ball_contacts import (
    BallContact,
    measure_contacts,
    scale_from_spheres,
)
from taccel_lab.calibration.scale.edge_line import find_edge
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.calibration.scale.result import ScaleCalibration, combine_axis
from taccel_lab.errors import InputError
from taccel_lab.report.remark import judge
from tests.calibration.drawn.faults import add_dust, add_noise, blur, poison, quantise
from tests.support.capture_sets import CaptureMaker, spread_circles
from tests.support.synthetic_presses import GRID, tiny_profile

BACKGROUND = np.full((240, 320, 3), (90.0, 120.0, 130.0))


def drawn_edge(
    ends: np.ndarray, *, decay_px: float = 1.5, noise: float = 1.5, seed: int = 0
) -> np.ndarray:
    """Two faces that meet in a sharp crest; beyond the ends the gel comes off it."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :320].astype(float)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.array([-along[1], along[0]])
    t = (u - ends[0][0]) * along[0] + (v - ends[0][1]) * along[1]
    d = (u - ends[0][0]) * across[0] + (v - ends[0][1]) * across[1]
    beyond = np.maximum(np.maximum(-t, t - np.linalg.norm(ends[1] - ends[0])), 0.0)
    height = np.exp(-beyond / decay_px)
    side = np.clip(d, -0.5, 0.5) * 2
    width = np.exp(-np.maximum(np.abs(d) - 12.0, 0.0) / 4.0)
    face = np.where(
        side[..., None] > 0, np.array([55.0, -30.0, -40.0]), np.array([-45.0, 10.0, 60.0])
    )
    image = BACKGROUND + face * (np.abs(side) * width * height)[..., None]
    image = add_dust(blur(image, 0.7), 8, rng)
    return quantise(add_noise(image, noise, rng))


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(
    u=st.floats(120, 200),
    v=st.floats(95, 145),
    angle=st.floats(-90, 90),
    length=st.floats(60, 130),
    seed=st.integers(0, 99),
)
def test_ends_are_found_within_their_uncertainty(
    u: float, v: float, angle: float, length: float, seed: int
) -> None:
    direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    ends = np.array([u, v]) + np.array([[-0.5], [0.5]]) * length * direction
    found = find_edge(drawn_edge(ends, seed=seed), BACKGROUND)
    sigma = np.hypot(found.length_sigma_px, found.systematic_px)
    assert abs(found.length_px - length) < max(4 * sigma, 2.0)
    assert np.linalg.norm(found.ends_px.mean(axis=0) - (u, v)) < 1.5
    turn = (found.angle_deg - angle + 90) % 180 - 90
    assert abs(turn) < 1.0


def test_masked_pixels_have_no_effect() -> None:
    ends = np.array([[90.0, 100.0], [220.0, 130.0]])
    mask = np.ones((240, 320), dtype=bool)
    mask[180:, :] = False
    image = drawn_edge(ends)
    clean = find_edge(image, BACKGROUND, mask=mask)
    poisoned = quantise(poison(image, mask, np.random.default_rng(0)))
    dirty = find_edge(poisoned, BACKGROUND, mask=mask)
    np.testing.assert_allclose(dirty.ends_px, clean.ends_px, atol=0.3)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (quantise(add_noise(BACKGROUND, 2.0, np.random.default_rng(0))), "no edge"),
        (BACKGROUND.astype(np.uint8), "nothing changes sharply"),
        (drawn_edge(np.array([[40.0, 120.0], [340.0, 125.0]])), "runs out|no end"),
        (np.zeros((100, 320, 3), np.uint8), "of one size"),
    ],
)
def test_pictures_without_a_whole_edge_are_refused(image: np.ndarray, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        find_edge(image, BACKGROUND)


def captured(images: list[np.ndarray], labels: list[LineEntry | None] | None = None):
    labels = labels or [None] * len(images)
    return [
        EdgeCapture(
            EdgeEntry(image=f"e{k}.png", length_mm=10.0, line=label),
            Frame(f"e{k}", f"e{k}.png", f"{k:064d}", lambda image=image: image),
        )
        for k, (image, label) in enumerate(zip(images, labels, strict=True))
    ]


def edges_at(scale: tuple[float, float], angles: list[float], share: float = 1.0) -> list:
    images = []
    for k, angle in enumerate(angles):
        direction = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        direction = direction / np.linalg.norm(direction * scale) * 10.0
        if k == 0:
            direction = direction * share
        middle = np.array([160.0 + 3 * k, 118.0 + 2 * k])
        images.append(
            drawn_edge(middle + np.array([[-0.5], [0.5]]) * direction, decay_px=0.5, seed=k)
        )
    return images


def test_scale_in_x_and_y_and_an_edge_that_touched_in_part() -> None:
    truth = (0.085, 0.080)
    images = edges_at(truth, [5, -10, 20, 80, 95, 60, -45], share=0.8)
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    assert found.x is not None and found.y is not None
    assert abs(found.x.value - truth[0]) < 3 * found.x.sigma
    assert abs(found.y.value - truth[1]) < 3 * found.y.sigma
    assert found.x.sigma < 0.015 * truth[0]
    assert found.x.value > found.y.value
    used = [edge["used"] for edge in found.evidence["edges"]]
    assert used == [False] + [True] * 6


def test_edges_along_one_axis_only_say_so() -> None:
    images = edges_at((0.085, 0.085), [2, -5, 8, 0, 4])
    found = scale_from_edges(*measure_edges(captured(images), BACKGROUND, None))
    assert found.x is not None and found.y is not None
    assert found.y.sigma > 2 * found.x.sigma
    assert any(remark.code == "too_few" for remark in found.remarks)


def test_a_drawn_line_stands_in_for_an_edge_that_is_not_found() -> None:
    empty = quantise(add_noise(BACKGROUND, 2.0, np.random.default_rng(0)))
    label = LineEntry(u_px=160, v_px=120, length_px=125.0, angle_deg=0.0)
    measured, refused = measure_edges(captured([empty], [label]), BACKGROUND, None)
    assert not refused and measured[0].line.length_px == pytest.approx(125.0)
    measured, refused = measure_edges(captured([empty]), BACKGROUND, None)
    assert not measured and "no edge" in refused[0]
    with pytest.raises(InputError, match="no pressed edge"):
        scale_from_edges(measured, refused)


@settings(max_examples=30, deadline=None)
@given(
    values=st.lists(st.floats(0.04, 0.06), min_size=2, max_size=5),
    sigmas=st.lists(st.floats(1e-4, 1e-3), min_size=5, max_size=5),
)
def test_the_mean_lies_among_the_estimates(values: list[float], sigmas: list[float]) -> None:
    named = [(str(k), Estimate(v, s)) for k, (v, s) in enumerate(zip(values, sigmas, strict=False))]
    found = combine_axis(named)
    assert min(values) - 1e-12 <= found.estimate.value <= max(values) + 1e-12
    assert len(found.pairs) == len(values) * (len(values) - 1) // 2
    if found.agrees and found.chi_square < found.freedom:
        assert found.estimate.sigma <= min(s for _, s in zip(values, sigmas, strict=False)) + 1e-15


def test_false_alarms_are_rare_and_real_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    agree = [
        combine_axis([(str(k), Estimate(rng.normal(0.05, 5e-4), 5e-4)) for k in range(3)]).agrees
        for _ in range(400)
    ]
    assert np.mean(agree) > 0.97
    apart = combine_axis([("a", Estimate(0.050, 5e-4)), ("b", Estimate(0.055, 5e-4))])
    assert not apart.agrees and abs(apart.pairs["a*b"]) == pytest.approx(7.07, abs=0.01)
    assert apart.estimate.sigma > 2e-3


def contact(radius_px: float, ball_mm: float) -> BallContact:
    circle = ContactCircle(100.0, 100.0, radius_px)
    press = CapturedPress(f"p{radius_px}", "p.png", "0" * 64, lambda: BACKGROUND, circle)
    return BallContact(press, ball_mm, circle)


def test_balls_give_a_limit_only() -> None:
    found = scale_from_spheres([contact(r, 2.0) for r in (30, 45, 55, 60, 61)], [])
    assert found.x is None and found.y is None
    assert found.upper_x == pytest.approx(2.0 / (60 - 1.645), rel=1e-9)
    # A single circle that is far too large is a mistake of detection.
    found = scale_from_spheres([contact(r, 2.0) for r in (30, 45, 55, 60, 140)], [])
    assert found.upper_x == pytest.approx(2.0 / (60 - 1.645), rel=1e-9)
    with pytest.raises(InputError, match="no contact"):
        scale_from_spheres([], ["p.png: nothing there"])


def test_contacts_are_found_on_pixels_that_are_higher_than_wide(tmp_path: Path) -> None:
    folder = CaptureMaker(spread_circles(2), labelled=False).load(tmp_path)
    for ratio in (0.98, 1.02):
        contacts, refused = measure_contacts(folder, ratio)
        assert len(contacts) == 2 and not refused


def write_folder(
    folder: Path,
    scale: tuple[float, float],
    *,
    marker_error: float = 1.0,
    ball_mm: float | None = None,
) -> Path:
    """Edges of 10 mm and markers of 2 mm pitch (wrongly stated by a factor)."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)

    def save(name: str, image: np.ndarray) -> None:
        cv2.imwrite(str(folder / name), quantise(image)[..., ::-1])

    save("background.png", add_noise(BACKGROUND, 1.0, rng))
    lines = ["schema_version = 2", 'sensor = "gelsight"', 'background = "background.png"']
    for k, image in enumerate(edges_at(scale, [5, -12, 85, 70])):
        save(f"edge_{k}.png", image)
        lines += ["[[edges]]", f'image = "edge_{k}.png"', "length_mm = 10.0"]
    dots = BACKGROUND.copy()
    v, u = np.mgrid[:240, :320]
    step = (2.0 / scale[0], 2.0 / scale[1])
    for i in range(-5, 6):
        for j in range(-4, 5):
            at = (160.3 + i * step[0], 119.6 + j * step[1])
            if 8 < at[0] < 312 and 8 < at[1] < 232:
                dots -= (
                    80 * np.exp(-((((u - at[0]) ** 2 + (v - at[1]) ** 2) / 3.5**2) ** 3))[..., None]
                )
    save("markers.png", add_noise(dots, 1.0, rng))
    pitch = 2.0 * marker_error
    lines += ["[markers]", 'rest = "markers.png"', f"pitch_x_mm = {pitch}", f"pitch_y_mm = {pitch}"]
    if ball_mm is not None:
        save("press.png", BACKGROUND)
        lines += ["[indenter]", f"radius_mm = {ball_mm}", "[[presses]]", 'image = "press.png"']
        lines.append("contact = {u_px = 160.0, v_px = 120.0, radius_px = 50.0}")
    (folder / "captures.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def calibrated(folder: Path) -> ScaleCalibration:
    return calibrate_scale(load_capture_folder(folder), tiny_profile(GRID))


@pytest.mark.thorough
def test_kinds_of_captures_agree(tmp_path: Path) -> None:
    truth = (0.085, 0.082)
    result = calibrated(write_folder(tmp_path / "ok", truth, ball_mm=8.0))
    assert {e.method for e in result.estimates} == {"edge", "markers", "spheres"}
    for axis, wanted in zip("xy", truth, strict=True):
        found = result.axes[axis]
        assert found.agrees and found.freedom == 1
        assert abs(found.estimate.value - wanted) < 3 * found.estimate.sigma
        assert found.estimate.sigma < 0.01 * wanted
    assert not any(remark.code == "scale_disagrees" for remark in result.remarks)


@pytest.mark.thorough
def test_the_scale_of_rectified_images_is_one_of_rectified_images(tmp_path: Path) -> None:
    folder = load_capture_folder(write_folder(tmp_path / "even", (0.085, 0.082)))
    measured = calibrate_scale(replace(folder, rectified=True), tiny_profile(GRID))
    assert measured.apply_to(tiny_profile(GRID)).camera.rectified


@pytest.mark.thorough
def test_a_wrong_pitch_and_a_wrong_ball_are_said_to_be_so(tmp_path: Path) -> None:
    """Markers stated 12 % too far apart; a ball whose contacts are larger than itself."""
    folder = write_folder(tmp_path / "bad", (0.085, 0.082), marker_error=1.12, ball_mm=2.0)
    result = calibrated(folder)
    codes = [remark.code for remark in result.remarks]
    assert codes.count("scale_disagrees") == 2 and "contacts_exceed_ball" in codes
    worst = max(result.axes["x"].pairs.items(), key=lambda item: abs(item[1]))
    assert "markers" in worst[0] and abs(worst[1]) > 4
    assert judge(result.remarks) == "weak"


def test_folders_without_known_lengths_are_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "b.png"), quantise(BACKGROUND))
    manifest = tmp_path / "captures.toml"
    manifest.write_text('schema_version = 2\nsensor = "gelsight"\nbackground = "b.png"\n')
    with pytest.raises(InputError, match="nothing of known length"):
        calibrated(tmp_path)
    manifest.write_text(
        'schema_version = 2\nsensor = "gelsight"\nbackground = "b.png"\n'
        '[indenter]\nradius_mm = 4.0\n[[presses]]\nimage = "b.png"\n'
        "contact = {u_px = 100.0, v_px = 100.0, radius_px = 40.0}\n"
    )
    result = calibrated(tmp_path)
    with pytest.raises(InputError, match=r"only limit it to 0\.10"):
        _ = result.scale


def test_a_stated_scale_is_taken_with_a_warning_and_checked_by_the_ball(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "b.png"), quantise(BACKGROUND))
    for ball_mm, contradicts in ((4.0, False), (1.0, True)):
        (tmp_path / "captures.toml").write_text(
            'schema_version = 2\nsensor = "gelsight"\nbackground = "b.png"\n'
            "mm_per_px_x = 0.05\nmm_per_px_y = 0.051\n"
            f'[indenter]\nradius_mm = {ball_mm}\n[[presses]]\nimage = "b.png"\n'
            "contact = {u_px = 100.0, v_px = 100.0, radius_px = 40.0}\n"
        )
        result = calibrated(tmp_path)
        assert result.scale == (0.05, 0.051)
        codes = [remark.code for remark in result.remarks]
        assert "scale_not_measured" in codes and ("contacts_exceed_ball" in codes) is contradicts
