# SPDX-License-Identifier: Apache-2.0
"""Colour calibration of captures with faults: what is found, taken off, or said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.report import color_page
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.report import write_page
from taccel_lab.calibration.result import Severity, Verdict, judge
from taccel_lab.calibration.surfaces import PressSurface
from taccel_lab.profile import Provenance
from tests.calibration.drawn.faults import add_noise, blur, drift, quantise, vignette
from tests.support.synthetic_presses import (
    GRID,
    calibrated,
    synthetic_captures,
    tiny_profile,
    with_circles,
    with_images,
)

QUICK = ColorFitOptions(
    hidden=(24, 24), steps=300, batch_pixels=1024, disc_pixels=800, ring_pixels=500,
    far_pixels=150, learning_rate=8e-3,
)  # fmt: skip


Sound = tuple[CaptureSet, list[PressSurface]]
"""Captures and the true surface of each press."""


def calibrate(
    captures: CaptureSet,
    surfaces: list[PressSurface],
    holdout_every: int = 4,
    options: ColorFitOptions = QUICK,
    **chosen: Any,
) -> ColorCalibration:
    return calibrated(captures, surfaces, holdout_every=holdout_every, options=options, **chosen)


def heldout_l1(result: ColorCalibration) -> float:
    return result.heldout_means()["disc_l1"]


def codes(result: ColorCalibration) -> set[str]:
    return {remark.code for remark in result.remarks}


def provenance_of(result: ColorCalibration) -> Provenance:
    block = result.apply_to(tiny_profile(GRID)).color
    assert block is not None
    return block.provenance


def in_drifting_light(captures: CaptureSet) -> CaptureSet:
    rng = np.random.default_rng(1)
    images = [
        quantise(drift(p.image(), rng.uniform(0.92, 1.08, 3), rng.uniform(-12, 12, 3)))
        for p in captures.presses
    ]
    return with_images(captures, images)


@pytest.fixture(scope="module")
def sound() -> tuple[CaptureSet, list[PressSurface]]:
    return synthetic_captures(12, noise=1.0)


def test_more_noise_is_seen_in_the_figures_and_nothing_else(sound: Sound) -> None:
    captures, surfaces = sound
    rng = np.random.default_rng(0)
    noisy = with_images(
        captures, [quantise(add_noise(p.image(), 6.0, rng)) for p in captures.presses]
    )
    quiet_result, noisy_result = calibrate(captures, surfaces), calibrate(noisy, surfaces)
    quiet, loud = heldout_l1(quiet_result), heldout_l1(noisy_result)
    # Mean absolute value of the noise: 0.8 of its deviation; the model adds little of its own.
    assert 0.8 * 6.0 < loud < 0.8 * 6.1 + quiet
    assert quiet < 2.5
    assert not codes(quiet_result) and judge(quiet_result.remarks) is Verdict.GOOD


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
    assert "explains_little" not in codes(result)


def test_drift_is_found_and_taken_off(sound: Sound) -> None:
    captures, surfaces = sound
    drifting = in_drifting_light(captures)
    result = calibrate(drifting, surfaces, drift="auto")
    choice = result.drift_choice
    assert choice is not None and choice.remove and result.drift_corrected
    assert choice.corrected_levels < 0.7 * choice.captured_levels
    assert codes(result) == {"drift_taken_off"}
    left_in = calibrate(drifting, surfaces, drift="off")
    assert not left_in.drift_corrected and "off_background" in codes(left_in)
    assert heldout_l1(result) < 0.6 * heldout_l1(left_in)
    steady = calibrate(captures, surfaces, drift="auto")
    assert steady.drift_choice is not None and not steady.drift_choice.remove


def test_drift_is_taken_off_where_contacts_have_a_third_of_the_height() -> None:
    """No pixel of such a picture lies beyond 2.5 radii of most contacts."""
    captures, surfaces = synthetic_captures(12, noise=1.0, radii_px=(34.0, 40.0), ball_mm=5.0)
    drifting = in_drifting_light(captures)
    result = calibrate(drifting, surfaces, drift="auto")
    assert result.drift_corrected and not result.failures
    assert heldout_l1(result) < 0.6 * heldout_l1(calibrate(drifting, surfaces, drift="off"))
    assert not calibrate(captures, surfaces, drift="auto").drift_corrected


def test_labels_that_all_lie_to_one_side_are_told(sound: Sound) -> None:
    captures, surfaces = sound
    circles = [press.circle for press in captures.presses if press.circle is not None]
    beside = with_circles(captures, [replace(c, u_px=c.u_px + 1.5) for c in circles])
    (remark,) = [
        item for item in fit_color(beside, circles, surfaces, options=QUICK).remarks
        if item.code == "labels_beside"
    ]  # fmt: skip
    assert "-1.5 and +0.0 px for the centre and +0.0 px for the radius" in str(remark)
    assert "labels_beside" not in codes(fit_color(captures, circles, surfaces, options=QUICK))


def test_an_outlier_is_named(sound: Sound) -> None:
    captures, surfaces = sound
    images = [press.image() for press in captures.presses]
    split = captures.split(4)
    turned = split.train[3]
    images[turned] = images[turned][::-1, ::-1].copy()
    result = calibrate(with_images(captures, images), surfaces, folds=3, table=True)
    (remark,) = [r for r in result.remarks if r.code == "outliers"]
    name, other = (captures.presses[i].name for i in (turned, split.train[2]))
    assert f"{name} (" in remark.message and f"{other} (" not in remark.message
    figures = result.figures()
    assert set(figures["left_out_disc_l1"]) == {captures.presses[i].name for i in split.train}
    assert figures["spread"]["fit_count"] == 3 and figures["spread"]["disc_levels"] > 0
    assert figures["taxim_table"]["disc_l1"] > 0
    provenance = provenance_of(result)
    assert provenance.verdict == "usable" and any(name in text for text in provenance.remarks)
    assert provenance.spread["ensemble_disc_levels"] == figures["spread"]["disc_levels"]


def test_a_model_that_explains_little_is_weak(sound: Sound) -> None:
    captures, surfaces = sound
    shuffled = [surfaces[(i + 5) % len(surfaces)] for i in range(len(surfaces))]
    result = calibrate(captures, shuffled)
    assert "explains_little" in codes(result) and judge(result.remarks) is Verdict.WEAK


def test_nothing_held_out_and_too_few_presses_are_said(sound: Sound) -> None:
    captures, surfaces = sound
    result = calibrate(captures, surfaces, holdout_every=0, options=replace(QUICK, steps=20))
    (remark,) = result.remarks
    assert remark.code == "nothing_held_out" and remark.severity is Severity.WARNING
    few = replace(captures, presses=captures.presses[:3])
    result = calibrate(few, surfaces[:3], holdout_every=0, options=replace(QUICK, steps=20))
    assert {r.code: r.severity for r in result.remarks}["color_few_presses"] is Severity.ERROR


def test_the_page_shows_every_press(sound: Sound, tmp_path: Path) -> None:
    captures, surfaces = sound
    result = calibrate(captures, surfaces, options=replace(QUICK, steps=60), folds=2, table=True)
    page = color_page(result)
    write_page(page, tmp_path / "report")
    assert {path.name for path in (tmp_path / "report").glob("*.png")} == {
        "coverage.png", "heldout.png", "loss.png",
    }  # fmt: skip
    html = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert all(f'<td class="short">p{i}</td>' in html for i in range(12))
    (presses,) = [table for table in page.tables if table.title.startswith("Presses")]
    values = [row[5] for row in presses.rows]
    assert values == sorted(values)
