# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job end to end, on captures small enough for a test."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.press_options import ColorFitOptions
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.profile import load_profile, validate_profile
from taccel_lab.scene import Element
from tests.support.commands import run
from tests.support.small_captures import GRID, everything_below, write_captures

FIT = "taccel_lab.calibration.color.fit"


def short_fit(**settings: Any) -> ColorFitOptions:
    return ColorFitOptions(**settings | {"steps": 200})


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[object]]:
    """The command of a demo; its press may have any accuracy, as ``test_press`` has the files."""
    root = tmp_path_factory.mktemp("demo")
    captures = write_captures(root / "captures")
    options = "--depth-mm 0.4 --only background color"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{FIT}.ColorFitOptions", short_fit)
        quick = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
        patch.setitem(PHYSICS, Accuracy.DEFAULT, quick)
        yield ["demo", "--captures", captures, "--out", root / "out" / "demo", *options.split()]


@pytest.fixture(scope="module")
def out(words: list[Any]) -> Path:
    """Its output after an interrupt in the fit of colours, and the same command again."""
    out = words[4]
    unfinished = out.with_name("demo_unfinished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{FIT}.fit_color_model", interrupt)
        assert run(*words) == 130
    assert os.listdir(out.parent) == [unfinished.name]
    assert list(json.loads((unfinished / "calibration.json").read_text())["blocks"]) == [
        "background"
    ]
    assert load_profile(unfinished / "profile").background is not None
    page = (unfinished / "report" / "background" / "report.html").stat()
    assert run(*words) == 0
    again = (out / "report" / "background" / "report.html").stat()
    assert (again.st_size, again.st_mtime_ns) == (page.st_size, page.st_mtime_ns)
    return out


@pytest.mark.thorough
def test_profile_report_and_press_are_there(
    out: Path, words: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert {path.name for path in out.iterdir()} == {OUTPUT_MARKER, "press", "profile", "report"}
    assert os.listdir(out.parent) == ["demo"]
    assert validate_profile(out / "profile") == []
    profile = load_profile(out / "profile")
    assert profile.color is not None and profile.background_rgb is not None
    assert profile.grid() == GRID
    color = json.loads((out / "report" / "color" / "report.json").read_text())["color"]
    assert color["heldout"]["disc_l1"] < 0.6 * color["background_only"]["disc_l1"]
    assert color["heldout"]["crop_psnr_db"] > color["background_only"]["crop_psnr_db"] + 3
    assert [row["name"] for row in color["presses"]] == ["p0"]
    provenance = profile.color.provenance
    assert "bonded layer of 5 mm" in provenance.method
    assert provenance.residuals["heldout_disc_l1"] == pytest.approx(color["heldout"]["disc_l1"])
    assert set(provenance.inputs) >= {"background", "p1", "p2", "p3", "p4"}
    page = (out / "report" / "report.html").read_text(encoding="utf-8")
    assert "Calibrated blocks" in page
    assert not any(outside in page for outside in ('src="http', "src='http", 'href="http'))
    for name in ("press.json", "signals.npz", "gel.vtu", "image.png", "scene.png"):
        assert (out / "press" / name).stat().st_size > 100
    press = json.loads((out / "press" / "press.json").read_text())
    assert press["path"]["depth_mm"] == 0.4 and press["press"]["force_n"] > 0
    with np.load(out / "press" / "signals.npz") as signals:
        change = (signals["rgb"].astype(float) - profile.background_rgb)[..., 0]
        mask = signals["contact_mask"]
        raw = cv2.imread(str(out / "press" / "image_raw.png"))[..., ::-1]
        assert np.array_equal(raw, signals["rgb"])
    # Lamp 0 shines along x: the red of left and right flanks of the dent lies on either side.
    x = np.broadcast_to(GRID.x_mm() - press["at_mm"][0], mask.shape)
    left, right = change[mask & (x < -0.3)].mean(), change[mask & (x > 0.3)].mean()
    assert left * right < 0 and min(abs(left), abs(right)) > 3
    # One that is interrupted leaves it as it is.
    before = everything_below(out)
    monkeypatch.setattr(f"{FIT}.fit_color_model", interrupt)
    assert run(*words) == 130
    assert everything_below(out) == before
    assert sorted(os.listdir(out.parent)) == ["demo", "demo_unfinished"]
