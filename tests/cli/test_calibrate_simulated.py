# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color`` with simulated presses, end to end on tiny captures."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.cli.app import main
from taccel_lab.profile import load_profile
from tests.support.small_captures import GRID, everything_below, write_captures, write_profile


def calibrate(captures: Path, out: Path, *options: str) -> int:
    return main(["calibrate", "color", str(captures), "--out", str(out), *options])


def test_captures_become_a_profile_that_can_be_pressed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    captures = write_captures(tmp_path / "captures")
    out = tmp_path / "calibrated" / "unit"
    options = ("--steps", "150", "--ensemble", "0", "--drift", "off", "--json")
    assert calibrate(captures, out, *options) == 0
    captured = capsys.readouterr()
    color = json.loads(captured.out)["color"]
    assert "found circles against 4 labels" in captured.err
    for key in ("crop_psnr_db", "crop_ssim", "disc_l1", "full_l1"):
        assert np.isfinite(color["heldout"][key]) and np.isfinite(color["background_only"][key])
    assert color["heldout"]["disc_l1"] < 0.6 * color["background_only"]["disc_l1"]
    assert color["heldout"]["crop_psnr_db"] > color["background_only"]["crop_psnr_db"] + 3
    assert [row["name"] for row in color["presses"]] == ["p0"]

    profile = load_profile(out)
    assert profile.grid() == GRID
    assert profile.color is not None
    assert "finite elements, friction 0" in profile.color.provenance.method
    assert set(profile.color.provenance.inputs) >= {"background", "p1", "p2", "p3", "p4"}
    assert sorted(os.listdir(out.parent)) == ["unit", "unit_report"]

    pressed = tmp_path / "press"
    assert main(["press", str(out), "--out", str(pressed), "--depth-mm", "0.4"]) == 0
    with np.load(pressed / "signals.npz") as signals:
        rgb, mask = signals["rgb"].astype(float), signals["contact_mask"]
    # Lamp 0 shines along x: the red of left and right flanks of the dent lies on either side.
    background = profile.background_rgb
    assert background is not None
    change = (rgb - background)[..., 0]
    x = np.broadcast_to(GRID.x_mm(), mask.shape)
    left, right = change[mask & (x < -0.3)].mean(), change[mask & (x > 0.3)].mean()
    assert left * right < 0 and min(abs(left), abs(right)) > 3


def test_base_profile_gives_the_design(tmp_path: Path) -> None:
    captures = write_captures(tmp_path / "captures")
    base = write_profile(tmp_path / "base", color=False)
    out = tmp_path / "unit"
    options = ["--base", str(base), "--steps", "5", "--ensemble", "0", "--holdout-every", "0"]
    options += ["--surface", "hertz"]
    assert calibrate(captures, out, *options) == 0
    assert load_profile(out).material == load_profile(base).material
    # Again, in the place of the first.
    assert calibrate(captures, out, *options) == 0
    assert sorted(os.listdir(tmp_path)) == ["base", "captures", "unit", "unit_report"]


def test_interrupted_simulation_leaves_the_earlier_profile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    captures = write_captures(tmp_path / "captures")
    out = write_profile(tmp_path / "unit")
    before = everything_below(tmp_path)
    monkeypatch.setattr("taccel_lab.calibration.simulate.simulate_presses", interrupt)
    assert calibrate(captures, out) == 130
    assert everything_below(tmp_path) == before
