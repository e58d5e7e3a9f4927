# SPDX-License-Identifier: Apache-2.0
"""The presses that colours and normals share: what a single wrong label or press leaves of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from taccel_lab.calibration.ball_presses import BallPresses, ball_presses
from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.press_options import BallPressOptions
from tests.support.capture_sets import CaptureMaker, gel, spread_circles


@pytest.mark.thorough
def test_a_wrong_label_and_an_untouched_frame_harm_no_other_press(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Half of the time that the check takes.
    monkeypatch.setattr("taccel_lab.calibration.check.run.check_slopes", lambda *_: [])
    maker = CaptureMaker(circles=spread_circles(12))

    def presses(name: str, **chosen: str) -> tuple[BallPresses, set[str]]:
        captures = maker.load(tmp_path / name)
        options = BallPressOptions(**chosen)  # type: ignore[arg-type]
        found = ball_presses(captures, base_profile(None, captures), "color", options, cache=False)
        return found, {remark.code for remark in (*found.findings, *found.remarks)}

    sound, _ = presses("sound")
    # A held-out press keeps its place without its label: no contact of the ball is as wide.
    held = sound.split.heldout[0]
    true = maker.labels[held]
    maker.labels[held] = replace(true, radius_px=24.0)
    found, codes = presses("held out")
    assert found.fitted.heldout is not None
    assert found.fitted.heldout.captures.rejected == {f"p{held:02d}"}
    assert found.split.heldout == sound.split.heldout
    assert "labels_unused" not in codes
    maker.labels[held] = true

    names = [press.name for press in sound.fitted.captures.presses]
    wrong, gone = (int(name[1:]) for name in names[:2])
    label = maker.labels[wrong]
    maker.labels[wrong] = replace(label, u_px=label.u_px + (22.0 if label.u_px < 80 else -22.0))
    maker.change([gone], lambda _: gel())
    found, codes = presses("spoilt")
    assert [press.name for press in found.fitted.captures.presses] == [names[0], *names[2:]]
    kept = [sound.fitted.circles[0], *sound.fitted.circles[2:]]
    for circle, before in zip(found.fitted.circles, kept, strict=True):
        assert circle.center_gap_px(before, found.captures.grid) < 0.7
        assert abs(circle.radius_px - before.radius_px) < 0.7
    assert (abs(found.fitted.placement.mean_px - sound.fitted.placement.mean_px) < 0.3).all()
    assert (found.fitted.placement.deviation_px < sound.fitted.placement.deviation_px + 0.3).all()
    assert {"labels_unused", "presses_left_out"} <= codes and "labels_off" not in codes
    # Who asks for the labels gets them, with a remark.
    asked, codes = presses("labels", circles="labels")
    assert asked.fitted.circles[0] == maker.labels[wrong] and "labels_off" in codes
