# SPDX-License-Identifier: Apache-2.0
"""Held-out presses that reach no model and stay in the figures; faults found, taken off or said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import (
    CapturedPress,
    CaptureSet,
    ContactCircle,
    load_capture_folder,
    load_captures,
)
from taccel_lab.calibration.capture.captures import without_labels
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.color.color_page import color_page
from taccel_lab.calibration.color.fit import calibrate_color, fit_color
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.press_options import ColorFitOptions, ColorOptions
from taccel_lab.calibration.response.frame import HeldoutSet
from taccel_lab.errors import InputError
from taccel_lab.report.page import write_page
from taccel_lab.report.remark import Severity, Verdict, judge
from tests.calibration.drawn.faults import add_noise, blur, drift, quantise, vignette
from tests.calibration.judged_once import detect_once, judge_slopes_once
from tests.support.synthetic_presses import (
    GRID,
    calibrated,
    flat_profile,
    synthetic_captures,
    true_surface,
    with_circles,
    with_images,
    without_check,
    write_captures,
)
from tests.support.variants import variants

QUICK = ColorFitOptions(
    hidden=(24, 24), steps=200, batch_pixels=1024, disc_pixels=800, ring_pixels=500,
    far_pixels=150, learning_rate=8e-3,
)  # fmt: skip

BRIEF = replace(QUICK, hidden=(16,), steps=60)
"""For short fits whose result has to be the same, be it good or not."""
FITTED = replace(QUICK, steps=300)


Sound = tuple[CaptureSet, list[BallSurface]]
"""Captures and the true surface of each press."""


@pytest.mark.thorough
@pytest.mark.parametrize("labelled", variants([False], [True, False]))
def test_canary_noise_in_held_out_images_changes_nothing_that_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, labelled: bool
) -> None:
    """The whole calibration, twice: weights, background, circles and split stay to the bit."""
    captures, _ = synthetic_captures(8, noise=1.0)
    names = [press.name for press in captures.presses]
    folder = write_captures(tmp_path / "captures", captures, () if labelled else names)
    names = load_captures(folder).split(4).heldout_names
    assert len(names) == 2
    detect_once(monkeypatch)
    judge_slopes_once(monkeypatch)
    if not labelled:
        # What it finds does not depend on labels being there.
        without_check(monkeypatch)
    options = ColorOptions(steps=40, cache=False, table=False)

    def run() -> tuple[ColorCalibration, dict[str, Any]]:
        result = calibrate_color(load_capture_folder(folder), flat_profile(GRID, 3.0), options)
        return result, result.figures()

    clean, before = run()
    rng = np.random.default_rng(9)
    for name in names:
        noise = rng.integers(0, 256, (GRID.height_px, GRID.width_px, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{name}.png"), noise)
    spoilt, after = run()
    for key, weight in clean.fit.model.weights.items():
        assert np.array_equal(weight, spoilt.fit.model.weights[key]), key
    assert np.array_equal(clean.fit.background, spoilt.fit.background)
    assert set(before["circles"]).isdisjoint(names)
    for key in (
        "split", "circles", "train_disc_l1", "loss_curve", "noise_floor_l1",
    ):  # fmt: skip
        assert before[key] == after[key], key
    # The canary sings: the figures are of the images that were spoilt.
    assert before["heldout_placed_by"] == ("label" if labelled else "found")
    assert before["heldout"]["crop_psnr_db"] > 25
    if labelled:
        assert after["heldout"]["crop_psnr_db"] < 15
    else:
        assert after["heldout"] is None and set(after["failures"]) == set(names)


@pytest.fixture(scope="module")
def sound() -> Sound:
    return synthetic_captures(12, noise=1.0)


@pytest.mark.thorough
def test_a_press_without_a_contact_lowers_the_figures(sound: Sound) -> None:
    captures, surfaces = sound
    split = captures.split(4)
    blank = dict.fromkeys(split.heldout)
    unlabelled = with_circles(captures, blank, heldout=split.heldout_names)
    whole = calibrated(unlabelled, surfaces, options=QUICK)
    assert whole.placement == "found"
    gone = split.heldout_names[1]
    empty = with_images(unlabelled, {split.heldout[1]: captures.background})
    result = calibrated(empty, surfaces, options=QUICK)
    (failure,) = result.failures
    assert failure.name == gone and "no contact found" in failure.reason
    worst = min(item.background_only.crop_psnr_db for item in result.heldout)
    rendered = [item.score.crop_psnr_db for item in result.heldout]
    assert result.heldout_means()["crop_psnr_db"] == pytest.approx(np.mean([*rendered, worst]))
    assert result.heldout_means()["crop_psnr_db"] < whole.heldout_means()["crop_psnr_db"] - 3


@pytest.mark.thorough
def test_a_label_that_its_image_rejects_stands_beside_the_figures(sound: Sound) -> None:
    captures, surfaces = sound
    split = captures.split(4)
    whole = calibrated(captures, surfaces, options=QUICK)
    wrong, gone, kept = split.heldout_names
    spoilt = with_images(captures, {split.heldout[1]: captures.background})
    presses = without_labels(spoilt.presses, [wrong, gone])
    spoilt = replace(spoilt, heldout=split.heldout_names, presses=presses)
    assert spoilt.split(4) == replace(captures, heldout=split.heldout_names).split(4)
    result = calibrated(spoilt, surfaces, options=QUICK)
    score = {item.name: item.score.crop_psnr_db for item in whole.heldout}[kept]
    assert result.heldout_means()["crop_psnr_db"] == pytest.approx(score, abs=0.01)
    assert result.placement == "label"
    figures = result.figures()
    assert set(figures["failures"]) == {gone} and figures["heldout_failed"] == 0
    assert figures["rejected_labels"][gone] is None and figures["rejected_labels"][wrong] > 25
    (remark,) = [remark for remark in result.remarks if remark.code == "labels_rejected"]
    assert wrong in remark.message and f"{gone} (not found)" in remark.message


@pytest.mark.thorough
def test_a_press_without_a_surface_spoils_no_other(sound: Sound) -> None:
    captures, surfaces = sound
    split = captures.split(4)
    bad = split.heldout_names[2]

    label = captures.presses[split.heldout[2]].circle

    def stubborn(circle: ContactCircle, ball_mm: float) -> BallSurface:
        if circle == label:
            raise InputError("larger than the ball")
        return true_surface(circle, ball_mm)

    training = captures.only(split.train)
    result = fit_color(
        training,
        [press.circle for press in training.presses if press.circle is not None],
        [surfaces[i] for i in split.train],
        HeldoutSet.of(captures, split, stubborn),
        options=BRIEF,
    )
    assert [failure.name for failure in result.failures] == [bad]
    assert {item.name for item in result.heldout} == set(split.heldout_names) - {bad}


@pytest.mark.thorough
def test_a_press_left_out_by_a_person_counts(sound: Sound) -> None:
    captures, surfaces = sound
    stated = (*captures.split(4).heldout_names, "p99")
    result = calibrated(captures, surfaces, heldout_names=stated, options=BRIEF)
    assert [failure.name for failure in result.failures] == ["p99"]


def test_labels_that_all_lie_to_one_side_are_shifted_by_what_training_says(sound: Sound) -> None:
    captures, _ = sound
    rng = np.random.default_rng(3)
    off = np.array([2.0, -1.5, 1.0])
    presses = []
    for press in captures.presses:
        assert press.circle is not None
        noise = rng.normal(0, 0.3, 3)
        values = np.array([press.circle.u_px, press.circle.v_px, press.circle.radius_px])
        presses.append(replace(press, circle=ContactCircle(*map(float, values - off + noise))))
    truth = [press.circle for press in captures.presses if press.circle is not None]
    shift = LabelPlacement.of(presses, truth)
    assert shift.mean_px == pytest.approx(off, abs=0.3) and shift.count == 12
    assert (shift.deviation_px < 0.6).all() and (shift.deviation_px > 0.1).all()
    label = presses[0].circle
    assert label is not None
    placed = shift.applied(label, 20.0)
    assert placed.u_px == pytest.approx(label.u_px + shift.mean_px[0])
    assert shift.radius_slope == pytest.approx(1.0, abs=0.15)
    assert shift.applied(replace(label, radius_px=30.0), 20.0).radius_px == pytest.approx(20.6)
    nothing = LabelPlacement.of([replace(p, circle=None) for p in presses], truth)
    assert nothing.count == 0 and nothing.applied(label, 20.0) == label


def test_radii_that_labels_scatter_are_drawn_to_their_mean() -> None:
    """Labels of equal contacts that differ by hand alone say nothing of a radius."""
    rng = np.random.default_rng(4)
    truth = [ContactCircle(50.0, 50.0, 20.0 + float(x)) for x in rng.normal(0, 0.2, 30)]
    labels = [replace(c, radius_px=c.radius_px + float(x)) for c, x in zip(
        truth, rng.normal(1.0, 2.0, 30), strict=True)]  # fmt: skip
    presses = [CapturedPress(f"p{i}", "", "", lambda: np.zeros(0), c) for i, c in enumerate(labels)]
    shift = LabelPlacement.of(presses, truth)
    assert 0.0 < shift.radius_slope < 0.2
    placed = shift.applied(ContactCircle(50.0, 50.0, 25.0), 40.0)
    assert placed.radius_px == pytest.approx(20.0, abs=1.0)
    assert shift.deviation_px[2] < 0.5


def calibrate(
    captures: CaptureSet,
    surfaces: list[BallSurface],
    holdout_every: int = 4,
    options: ColorFitOptions = FITTED,
    **chosen: Any,
) -> ColorCalibration:
    return calibrated(captures, surfaces, holdout_every=holdout_every, options=options, **chosen)


@pytest.fixture(scope="module")
def steady(sound: Sound) -> ColorCalibration:
    """The sound captures fitted in full."""
    return calibrate(*sound, table=True)


def heldout_l1(result: ColorCalibration) -> float:
    return result.heldout_means()["disc_l1"]


def codes(result: ColorCalibration) -> set[str]:
    return {remark.code for remark in result.remarks}


def in_drifting_light(captures: CaptureSet) -> CaptureSet:
    rng = np.random.default_rng(1)
    images = [
        quantise(drift(p.image(), rng.uniform(0.92, 1.08, 3), rng.uniform(-12, 12, 3)))
        for p in captures.presses
    ]
    return with_images(captures, images)


@pytest.mark.thorough
def test_more_noise_is_seen_in_the_figures_and_nothing_else(
    sound: Sound, steady: ColorCalibration
) -> None:
    captures, surfaces = sound
    rng = np.random.default_rng(0)
    noisy = with_images(
        captures, [quantise(add_noise(p.image(), 6.0, rng)) for p in captures.presses]
    )
    quiet, loud = heldout_l1(steady), heldout_l1(calibrate(noisy, surfaces))
    # Mean absolute value of the noise: 0.8 of its deviation; the model adds little of its own.
    assert 0.8 * 6.0 < loud < 0.8 * 6.1 + quiet
    assert quiet < 2.5
    assert not codes(steady) and judge(steady.remarks) is Verdict.GOOD


@pytest.mark.thorough
def test_blur_and_vignetting_of_camera_and_lamps_are_learned(sound: Sound) -> None:
    captures, surfaces = sound

    def through_lens(image: np.ndarray) -> np.ndarray:
        return quantise(vignette(blur(image, 1.0), 0.3))

    seen = with_images(
        captures,
        [through_lens(press.image()) for press in captures.presses],
        background=through_lens(captures.background),
    )
    result = calibrate(seen, surfaces)
    assert heldout_l1(result) < 3.0
    assert "heldout_error" not in codes(result)


@pytest.mark.thorough
def test_drifting_light_is_taken_off(sound: Sound, steady: ColorCalibration) -> None:
    captures, surfaces = sound
    result = calibrate(in_drifting_light(captures), surfaces)
    assert codes(result) == set()
    assert heldout_l1(result) < heldout_l1(steady) + 0.7


@pytest.mark.thorough
def test_drift_is_taken_off_where_contacts_have_a_third_of_the_height() -> None:
    """No pixel of such a picture lies beyond 2.5 radii of most contacts."""
    captures, surfaces = synthetic_captures(12, noise=1.0, radii_px=(34.0, 40.0), ball_mm=5.0)
    result = calibrate(in_drifting_light(captures), surfaces)
    assert not result.failures
    assert heldout_l1(result) < heldout_l1(calibrate(captures, surfaces)) + 1.5


@pytest.mark.thorough
def test_an_outlier_is_named(sound: Sound) -> None:
    captures, surfaces = sound
    images = [press.image() for press in captures.presses]
    split = captures.split(4)
    turned = split.train[3]
    images[turned] = images[turned][::-1, ::-1].copy()
    result = calibrate(with_images(captures, images), surfaces, table=True)
    (remark,) = [r for r in result.remarks if r.code == "outliers"]
    name, other = (captures.presses[i].name for i in (turned, split.train[2]))
    assert f"{name} (" in remark.message and f"{other} (" not in remark.message
    figures = result.figures()
    assert figures["taxim_table"]["disc_l1"] > 0
    block = result.apply_to(flat_profile(GRID, 3.0)).color
    assert block is not None
    provenance = block.provenance
    assert provenance.verdict == "usable" and any(name in text for text in provenance.remarks)


@pytest.mark.thorough
def test_a_model_that_explains_little_is_weak(sound: Sound) -> None:
    captures, surfaces = sound
    shuffled = [surfaces[(i + 5) % len(surfaces)] for i in range(len(surfaces))]
    result = calibrate(captures, shuffled, options=BRIEF)
    assert "heldout_error" in codes(result) and judge(result.remarks) is Verdict.WEAK


@pytest.mark.thorough
def test_nothing_held_out_and_too_few_presses_are_said(sound: Sound) -> None:
    captures, surfaces = sound
    result = calibrate(captures, surfaces, holdout_every=0, options=replace(FITTED, steps=20))
    (remark,) = result.remarks
    assert remark.code == "nothing_held_out" and remark.severity is Severity.WARNING
    few = replace(captures, presses=captures.presses[:3])
    result = calibrate(few, surfaces[:3], holdout_every=0, options=replace(FITTED, steps=20))
    assert {r.code: r.severity for r in result.remarks}["too_few"] is Severity.ERROR


@pytest.mark.thorough
def test_the_page_shows_every_press(steady: ColorCalibration, tmp_path: Path) -> None:
    page = color_page(steady)
    write_page(page, tmp_path / "report")
    assert {path.name for path in (tmp_path / "report").glob("*.png")} == {
        "coverage.png", "heldout.png",
    }  # fmt: skip
    html = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert all(f'<td class="short">p{i}</td>' in html for i in range(12))
    (presses,) = [table for table in page.tables if table.title.startswith("Presses")]
    values = [row[5] for row in presses.rows]
    assert values == sorted(values, reverse=True)
