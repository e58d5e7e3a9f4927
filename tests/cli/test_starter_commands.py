# SPDX-License-Identifier: Apache-2.0
"""Commands that read with a starter profile: one rule for the untouched frame, the same remarks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import taccel_lab as tl
from tests.cli.conftest import Cli
from tests.support.real_data import real_data

SDK = "gsmini_gs_sdk/examples/data"
STARTER = "starter profile of another unit: calibrate yours"
ASKED = "is of another unit"


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """A press of a stranger's Mini, without its background."""
    folder = tmp_path / "photos"
    folder.mkdir()
    shutil.copy(real_data(f"{SDK}/bead.png"), folder)
    return folder


def test_without_an_untouched_frame_all_commands_ask_for_it(
    photos: Path, tmp_path: Path, cli: Cli
) -> None:
    out, live = tmp_path / "out", ("--no-page", "--no-paced")
    image = photos / "bead.png"
    for words in (
        ("depth", "gelsight_mini", image, "--out", out),
        ("read", "gelsight_mini", photos, "--out", out),
        ("read", "gelsight_mini", image, "--out", out),
        ("press", "gelsight_mini", "--like", image, "--out", out),
        ("live", "gelsight_mini", "--camera", photos, *live),
    ):
        said = cli.refusal(*words)
        assert ASKED in said and "give an image of your untouched sensor: " in said
    assert not out.exists()
    said = cli.refusal("live gelsight_mini", "--camera", photos, *live, "--background", "profile")
    assert "has the background of another unit" in said


@pytest.mark.thorough
def test_depth_read_and_live_find_it_and_say_the_same(
    photos: Path, tmp_path: Path, cli: Cli
) -> None:
    shutil.copy(real_data(f"{SDK}/background.png"), photos)
    depth = cli.json("depth gelsight_mini", photos / "bead.png", "--out", tmp_path / "depth")
    (about,) = depth["images"].values()
    remarks = [*about["warnings"], *about["force_remarks"]]
    found = f"untouched gel: {photos / 'background.png'}, by its name"
    assert STARTER in remarks and found in remarks
    assert any("Young's modulus" in remark for remark in remarks)
    printed = cli("read gelsight_mini", photos, "--out", tmp_path / "read").out
    rows = json.loads((tmp_path / "read" / "readings.json").read_text())["frames"]
    assert [row["name"] for row in rows] == ["background.png", "bead.png"]
    assert rows[1]["remarks"] == remarks and rows[0]["force_n"] == 0
    assert all(remark in " ".join(printed.split()) for remark in remarks)
    live = cli.json("live gelsight_mini", "--camera", photos, "--no-page", "--no-paced")
    assert live["latency"]["frames"] == 2
    called = tl.read("gelsight_mini", photos / "bead.png")
    for name in ("depth_mm", "depth_error_mm", "area_mm2", "force_n"):
        number = getattr(called, name)
        assert number > 0 and number == about[name] == rows[1][name] == live["last"][name], name
    assert about["words"] == live["last"]["words"] == list(called.words)
    assert {STARTER, found} <= {f"{text[0].lower()}{text[1:-1]}" for text in live["remarks"]}
