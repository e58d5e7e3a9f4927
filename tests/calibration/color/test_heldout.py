# SPDX-License-Identifier: Apache-2.0
"""Held-out presses that reach no model and stay in the figures; faults found, taken off or said."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration import capture
from taccel_lab.calibration.capture import CaptureSet, ContactCircle, load_capture_folder
from taccel_lab.calibration.capture.captures import without_labels
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.color_page import color_page
from taccel_lab.calibration.color.fit import calibrate_color, fit_color
from taccel_lab.calibration.color.options import ColorFitOptions, ColorOptions
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.response.frame import FittedPresses, HeldoutSet
from taccel_lab.errors import InputError
from taccel_lab.report.page import write_page
from taccel_lab.report.remark import Severity, Verdict, judge
from tests.calibration.drawn.faults import add_noise, blur, drift, quantise, vignette
from tests.calibration.judged_once import detect_once, judge_slopes_once
from tests.support import synthetic_presses as synthetic
from tests.support.synthetic_presses import GRID, calibrated, synthetic_captures, with_images
from tests.support.variants import variants

QUICK = ColorFitOptions(
    hidden=(24, 24), steps=200, batch_pixels=1024, disc_pixels=800, ring_pixels=500,
    far_pixels=150, learning_rate=8e-3,
)  # fmt: skip
BRIEF = replace(QUICK, hidden=(16,), steps=60)
"""For short fits whose result has to be the same, be it good or not."""
Sound = tuple[CaptureSet, list[BallSurface]]
"""Captures and the true surface of each press."""


@pytest.mark.thorough
@pytest.mark.parametrize("labelled", variants([False], [True, False]))
def test_canary_noise_in_held_out_images_changes_nothing_that_is_fitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, labelled: bool
) -> None:
    """The whole calibration, twice: weights, background, circles and split stay to the bit."""
    captures, _ = synthetic_captures(8, noise=1.0)
    everyone = [press.name for press in captures.presses]
    folder = synthetic.write_captures(tmp_path / "captures", captures, () if labelled else everyone)
    detect_once(monkeypatch)
    judge_slopes_once(monkeypatch)
    if not labelled:
        # What it finds does not depend on labels being there.
        synthetic.without_check(monkeypatch)
    options = ColorOptions(steps=40, cache=False, table=False)

    def run() -> ColorCalibration:
        return calibrate_color(
            load_capture_folder(folder), synthetic.flat_profile(GRID, 3.0), options
        )

    clean, names = run(), capture.load_captures(folder).split(4).heldout_names
    rng = np.random.default_rng(9)
    for name in names:
        noise = rng.integers(0, 256, (GRID.height_px, GRID.width_px, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / f"{name}.png"), noise)
    spoilt = run()
    before, after = clean.figures(), spoilt.figures()
    for key, weight in clean.fit.model.weights.items():
        assert np.array_equal(weight, spoilt.fit.model.weights[key]), key
    assert np.array_equal(clean.fit.background, spoilt.fit.background)
    for key in ("split", "circles", "train_disc_l1", "loss_curve", "noise_floor_l1"):
        assert before[key] == after[key], key
    # The canary sings: the figures are of the images that were spoilt.
    assert before["heldout_placed_by"] == ("label" if labelled else "found")
    assert before["heldout"]["crop_psnr_db"] > 25
    if labelled:
        assert after["heldout"]["crop_psnr_db"] < 15
    else:
        assert after["heldout"] is None and set(after["failures"]) == set(names)
    assert len(names) == 2 and set(before["circles"]).isdisjoint(names)


@pytest.fixture(scope="module")
def sound() -> Sound:
    return synthetic_captures(12, noise=1.0)


def calibrate(
    captures: CaptureSet, surfaces: list[BallSurface], every: int = 4, steps: int = 300, **more: Any
) -> ColorCalibration:
    options = replace(QUICK, steps=steps)
    return calibrated(captures, surfaces, holdout_every=every, options=options, **more)


@pytest.fixture(scope="module")
def steady(sound: Sound) -> ColorCalibration:
    """The sound captures fitted in full."""
    return calibrate(*sound, table=True)


def heldout_l1(result: ColorCalibration) -> float:
    return result.heldout_means()["disc_l1"]


def codes(result: ColorCalibration) -> set[str]:
    return {remark.code for remark in result.remarks}


def changed(captures: CaptureSet, how: Callable[[np.ndarray], np.ndarray]) -> CaptureSet:
    """Captures whose images have all gone through ``how``."""
    return with_images(captures, [quantise(how(press.image())) for press in captures.presses])


def in_drifting_light(captures: CaptureSet) -> CaptureSet:
    rng = np.random.default_rng(1)
    light = lambda: (rng.uniform(0.92, 1.08, 3), rng.uniform(-12, 12, 3))  # noqa: E731
    return changed(captures, lambda image: drift(image, *light()))


@pytest.mark.thorough
def test_a_press_without_a_contact_lowers_the_figures(sound: Sound) -> None:
    captures, surfaces = sound
    split = captures.split(4)
    blank = dict.fromkeys(split.heldout)
    unlabelled = synthetic.with_circles(captures, blank, heldout=split.heldout_names)
    whole = calibrated(unlabelled, surfaces, options=QUICK)
    assert whole.placement == "found"
    empty = with_images(unlabelled, {split.heldout[1]: captures.background})
    result = calibrated(empty, surfaces, options=QUICK)
    (failure,) = result.failures
    assert failure.name == split.heldout_names[1] and "no contact found" in failure.reason
    worst = min(item.background_only.crop_psnr_db for item in result.heldout)
    rendered = [item.score.crop_psnr_db for item in result.heldout]
    psnr_db = result.heldout_means()["crop_psnr_db"]
    assert psnr_db == pytest.approx(np.mean([*rendered, worst]))
    assert psnr_db < whole.heldout_means()["crop_psnr_db"] - 3


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
    figures = result.figures()
    assert result.placement == "label" and figures["heldout_failed"] == 0
    assert set(figures["failures"]) == {gone}
    assert figures["rejected_labels"][gone] is None and figures["rejected_labels"][wrong] > 25
    (remark,) = [remark for remark in result.remarks if remark.code == "labels_rejected"]
    assert wrong in remark.message and f"{gone} (not found)" in remark.message


@pytest.mark.thorough
def test_a_press_without_a_surface_or_left_out_by_a_person_counts(sound: Sound) -> None:
    captures, surfaces = sound
    split = captures.split(4)
    *others, bad = split.heldout_names
    label = captures.presses[split.heldout[-1]].circle

    def stubborn(circle: ContactCircle, ball_mm: float) -> BallSurface:
        if circle == label:
            raise InputError("larger than the ball")
        return synthetic.true_surface(circle, ball_mm)

    training, known = captures.only(split.train), [surfaces[i] for i in split.train]
    held = HeldoutSet.of(captures, split, stubborn)
    presses = FittedPresses(training, synthetic.circles_of(training), known, held)
    result = fit_color(presses, BRIEF)
    assert [failure.name for failure in result.failures] == [bad]
    assert {item.name for item in result.heldout} == set(others)
    stated = (*split.heldout_names, "p99")
    result = calibrated(captures, surfaces, heldout_names=stated, options=BRIEF)
    assert [failure.name for failure in result.failures] == ["p99"]


@pytest.mark.thorough
def test_more_noise_is_seen_in_the_figures(sound: Sound, steady: ColorCalibration) -> None:
    rng = np.random.default_rng(0)
    noisy = changed(sound[0], lambda image: add_noise(image, 6.0, rng))
    quiet, loud = heldout_l1(steady), heldout_l1(calibrate(noisy, sound[1]))
    # Mean absolute value of the noise: 0.8 of its deviation; the model adds little of its own.
    assert 0.8 * 6.0 < loud < 0.8 * 6.1 + quiet
    assert quiet < 2.5
    assert not codes(steady) and judge(steady.remarks) is Verdict.GOOD


@pytest.mark.thorough
def test_blur_and_vignetting_of_camera_and_lamps_are_learned(sound: Sound) -> None:
    def through_lens(image: np.ndarray) -> np.ndarray:
        return quantise(vignette(blur(image, 1.0), 0.3))

    seen = changed(sound[0], through_lens)
    result = calibrate(replace(seen, background=through_lens(seen.background)), sound[1])
    assert heldout_l1(result) < 3.0 and "heldout_error" not in codes(result)


@pytest.mark.thorough
def test_drifting_light_is_taken_off(sound: Sound, steady: ColorCalibration) -> None:
    result = calibrate(in_drifting_light(sound[0]), sound[1])
    assert codes(result) == set() and heldout_l1(result) < heldout_l1(steady) + 0.7
    # No pixel of a picture lies beyond 2.5 radii of contacts of a third of its height.
    captures, surfaces = synthetic_captures(12, noise=1.0, radii_px=(34.0, 40.0), ball_mm=5.0)
    result = calibrate(in_drifting_light(captures), surfaces)
    assert not result.failures
    assert heldout_l1(result) < heldout_l1(calibrate(captures, surfaces)) + 1.5


@pytest.mark.thorough
def test_an_outlier_is_named(sound: Sound) -> None:
    captures, surfaces = sound
    other, turned = captures.split(4).train[2:4]
    image = captures.presses[turned].image()[::-1, ::-1].copy()
    result = calibrate(with_images(captures, {turned: image}), surfaces, table=True)
    (remark,) = [r for r in result.remarks if r.code == "outliers"]
    assert f"p{turned} (" in remark.message and f"p{other} (" not in remark.message
    assert result.figures()["taxim_table"]["disc_l1"] > 0
    block = result.apply_to(synthetic.flat_profile(GRID, 3.0)).color
    assert block is not None and block.provenance.verdict == "usable"
    assert any(f"p{turned}" in text for text in block.provenance.remarks)


@pytest.mark.thorough
def test_what_explains_little_or_rests_on_little_is_said(sound: Sound) -> None:
    captures, surfaces = sound
    result = calibrated(captures, [*surfaces[5:], *surfaces[:5]], options=BRIEF)
    assert "heldout_error" in codes(result) and judge(result.remarks) is Verdict.WEAK
    (remark,) = calibrate(captures, surfaces, 0, steps=20).remarks
    assert remark.code == "nothing_held_out" and remark.severity is Severity.WARNING
    few = replace(captures, presses=captures.presses[:3])
    remarks = calibrate(few, surfaces[:3], 0, steps=20).remarks
    assert {r.code: r.severity for r in remarks}["too_few"] is Severity.ERROR


@pytest.mark.thorough
def test_the_page_shows_every_press(steady: ColorCalibration, tmp_path: Path) -> None:
    page = color_page(steady)
    write_page(page, tmp_path)
    assert {path.name for path in tmp_path.glob("*.png")} == {"coverage.png", "heldout.png"}
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(f'<td class="short">p{i}</td>' in html for i in range(12))
    (presses,) = [table for table in page.tables if table.title.startswith("Presses")]
    values = [row[5] for row in presses.rows]
    assert values == sorted(values, reverse=True)
