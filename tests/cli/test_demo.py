# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job end to end, on captures small enough for a test."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
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
from tests.cli.conftest import Cli
from tests.support.commands import run
from tests.support.small_captures import GRID, everything_below, write_captures


def short_fit(**settings: Any) -> ColorFitOptions:
    return ColorFitOptions(**settings | {"steps": 200})


@pytest.fixture(scope="module", autouse=True)
def quick_presses_and_fits() -> Iterator[None]:
    """The demo shows a press of any accuracy; ``test_press`` holds the default's files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("taccel_lab.calibration.color.fit.ColorFitOptions", short_fit)
        quick = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
        patch.setitem(PHYSICS, Accuracy.DEFAULT, quick)
        yield


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captures(tmp_path_factory.mktemp("demo") / "captures")


@pytest.fixture(scope="module")
def words(captures: Path) -> list[str]:
    """The command of one demo."""
    folder = captures.parent / "out" / "demo"
    options = ["--depth-mm", "0.4", "--only", "background", "color"]
    return ["demo", "--captures", str(captures), "--out", str(folder), *options]


@pytest.fixture(scope="module")
def kept(captures: Path, words: list[str]) -> tuple[bytes, int]:
    """Text and time of the page that a demo leaves which is killed while it fits colours."""
    out = captures.parent / "out" / "demo"
    kept = out.with_name("demo_unfinished")
    page = kept / "report" / "background" / "report.html"
    command = [sys.executable, "-m", "taccel_lab.cli.app", *words]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as running:
        until = time.monotonic() + 400
        while not (page.is_file() and (kept / "calibration.json").is_file()):
            assert running.poll() is None and time.monotonic() < until
            time.sleep(0.02)
        running.kill()
    assert running.returncode == -signal.SIGKILL and not out.exists()
    assert list(json.loads((kept / "calibration.json").read_text())["blocks"]) == ["background"]
    assert load_profile(kept / "profile").background is not None
    return page.read_bytes(), page.stat().st_mtime_ns


@pytest.fixture(scope="module")
def out(captures: Path, words: list[str], kept: tuple[bytes, int]) -> Path:
    """Output of the same command after that."""
    assert run(*words) == 0
    return captures.parent / "out" / "demo"


@pytest.mark.thorough
def test_after_a_kill_what_was_finished_is_kept(out: Path, kept: tuple[bytes, int]) -> None:
    page = out / "report" / "background" / "report.html"
    assert (page.read_bytes(), page.stat().st_mtime_ns) == kept


@pytest.mark.thorough
def test_profile_report_and_press_are_there(out: Path) -> None:
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
    for outside in ('src="http', "src='http", 'href="http'):
        assert outside not in page
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


@pytest.mark.thorough
def test_interrupted_in_the_middle(
    captures: Path, out: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("taccel_lab.calibration.color.fit.fit_color_model", interrupt)
    before = everything_below(out)
    for folder in (tmp_path / "new" / "demo", out):
        assert run("demo", "--captures", captures, "--out", folder) == 130
        kept = folder.with_name("demo_unfinished")
        assert load_profile(kept / "profile").background is not None
        assert sorted(os.listdir(folder.parent)) == sorted(
            {kept.name} | ({"demo"} if folder == out else set())
        )
    assert everything_below(out) == before


def test_a_press_too_deep_is_refused_before_any_work(
    captures: Path, tmp_path: Path, forbid: Callable[[str], None], cli: Cli
) -> None:
    forbid("taccel_lab.calibration.calibrate.calibrate")
    told = cli.refusal("demo --captures", captures, "--out", tmp_path / "demo", "--depth-mm", "5.2")
    assert "depth 5.2 mm goes past the gel, which is 5 mm thick" in told
    assert not any(tmp_path.iterdir())
