# SPDX-License-Identifier: Apache-2.0
"""The presses that colours and normals share: what a single wrong label or press leaves of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from taccel_lab.calibration.ball_presses import BallPresses, ball_presses
from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.press_options import BallPressOptions
from tests.calibration.judged_once import detect_once
from tests.support.capture_sets import CaptureMaker, gel, spread_circles


@pytest.fixture(autouse=True)
def _no_ball_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time that the check takes."""
    monkeypatch.setattr("taccel_lab.calibration.check.run.check_slopes", lambda *_: [])
    detect_once(monkeypatch)


def presses_of(maker: CaptureMaker, folder: Path, **chosen: str) -> BallPresses:
    captures = maker.load(folder)
    options = BallPressOptions(**chosen)  # type: ignore[arg-type]
    return ball_presses(captures, base_profile(None, captures), "color", options, cache=False)


def codes(presses: BallPresses) -> set[str]:
    return {remark.code for remark in (*presses.findings, *presses.remarks)}


@pytest.mark.thorough
def test_one_wrong_label_and_one_untouched_frame_harm_no_other_press(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=spread_circles(12))
    sound = presses_of(maker, tmp_path / "sound")
    names = [press.name for press in sound.training.presses]
    wrong, gone = (int(name[1:]) for name in names[:2])
    label = maker.labels[wrong]
    away = 22.0 if label.u_px < 80 else -22.0
    maker.labels[wrong] = replace(label, u_px=label.u_px + away)
    maker.change([gone], lambda _: gel())
    found = presses_of(maker, tmp_path / "spoilt")
    assert [press.name for press in found.training.presses] == [names[0], *names[2:]]
    kept = [sound.circles[0], *sound.circles[2:]]
    grid = found.captures.grid
    for circle, before in zip(found.circles, kept, strict=True):
        assert circle.center_gap_px(before, grid) < 0.7
        assert abs(circle.radius_px - before.radius_px) < 0.7
    assert (abs(found.labels.mean_px - sound.labels.mean_px) < 0.3).all()
    assert (found.labels.deviation_px < sound.labels.deviation_px + 0.3).all()
    assert {"labels_unused", "presses_left_out"} <= codes(found)
    assert "labels_off" not in codes(found)
    # Who asks for the labels gets them, with a remark.
    asked = presses_of(maker, tmp_path / "labels", circles="labels")
    assert asked.circles[0] == maker.labels[wrong] and "labels_off" in codes(asked)


@pytest.mark.thorough
def test_a_held_out_press_keeps_its_place_without_its_label(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=spread_circles(12))
    split = maker.load(tmp_path / "sound").ball_presses().split(4)
    wrong = split.heldout[0]
    # No contact of the ball is as wide: that alone had ended the calibration.
    maker.labels[wrong] = replace(maker.labels[wrong], radius_px=24.0)
    found = presses_of(maker, tmp_path / "spoilt")
    assert found.heldout.captures.rejected == {f"p{wrong:02d}"}
    assert found.split.heldout == split.heldout
    assert "labels_unused" not in codes(found)
