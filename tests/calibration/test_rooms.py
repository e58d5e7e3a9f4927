# SPDX-License-Identifier: Apache-2.0
"""A block enters its own room: files that its check runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.calibration.blocks import HOMES
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.check.run import capture_check
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
def test_what_is_checked_for_a_block_enters_no_room_of_another(tmp_path: Path) -> None:
    place = write_captures(tmp_path / "captures", synthetic_captures(3)[0])
    manifest = place / "captures.toml"
    manifest.write_text(manifest.read_text() + OTHERS)

    def entered(*only: str) -> set[str]:
        folder = load_capture_folder(place)
        called = files_run(lambda: capture_check(folder, only=only))
        ours = [name.split("/") for name in called if name.startswith("taccel_lab/calibration/")]
        return {parts[2] for parts in ours} & HOMES.keys()

    others = {"camera", "scale", "markers"}
    assert others <= entered() and entered("normals") <= {"normals"}
