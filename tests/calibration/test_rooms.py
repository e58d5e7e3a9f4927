# SPDX-License-Identifier: Apache-2.0
"""A block enters its own room: files that its check runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.calibration.ball_presses import BallPresses, ball_presses
from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.blocks import HOMES
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.check.run import capture_check
from taccel_lab.calibration.press_options import BallPressOptions
from tests.support.synthetic_presses import synthetic_captures, write_captures
from tests.support.walked import files_run

OTHERS = """
[[boards]]
kind = "dots"
columns = 5
rows = 4
pitch_mm = 2.0
on_gel = true
images = ["background.png"]
[markers]
rest = "background.png"
[[edges]]
image = "p1.png"
length_mm = 5.0
"""


@pytest.mark.thorough
def test_what_is_checked_for_a_block_enters_no_room_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Half of the time that the check takes.
    monkeypatch.setattr("taccel_lab.calibration.check.run.check_slopes", lambda *_: [])
    place = write_captures(tmp_path / "captures", synthetic_captures(4)[0])
    manifest = place / "captures.toml"
    manifest.write_text(manifest.read_text() + OTHERS)

    def entered(call: Callable[[CaptureFolder], object]) -> set[str]:
        folder = load_capture_folder(place)
        called = files_run(lambda: call(folder))
        ours = [name.split("/") for name in called if name.startswith("taccel_lab/calibration/")]
        return {parts[2] for parts in ours} & HOMES.keys()

    def presses(folder: CaptureFolder) -> BallPresses:
        return ball_presses(folder, base_profile(None, folder), "normals", BallPressOptions())

    assert {"camera", "scale", "markers"} <= entered(capture_check)
    assert entered(presses) <= {"normals", "background"}
