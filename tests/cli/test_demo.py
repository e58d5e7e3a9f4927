# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job end to end, on captures small enough for a test."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.profile import load_profile, validate_profile
from tests.cli.conftest import Cli
from tests.support.commands import run
from tests.support.small_captures import GRID, everything_below, write_captures


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captures(tmp_path_factory.mktemp("demo") / "captures")


@pytest.fixture(scope="module")
def out(captures: Path) -> Path:
    """Output of one demo."""
    folder = captures.parent / "out" / "demo"
    arguments = ["--captures", captures, "--out", folder, "--depth-mm", "0.4"]
    assert run("demo", *arguments, "--only", "background", "color") == 0
    return folder


def test_profile_report_and_press_are_there(out: Path) -> None:
    assert {path.name for path in out.iterdir()} == {OUTPUT_MARKER, "press", "profile", "report"}
    assert os.listdir(out.parent) == ["demo"]
    assert validate_profile(out / "profile") == []
    profile = load_profile(out / "profile")
    assert profile.color is not None and profile.background_rgb is not None
    assert profile.grid() == GRID
    figures = json.loads((out / "report" / "color" / "report.json").read_text())
    assert figures["color"]["heldout"]["disc_l1"] < figures["color"]["background_only"]["disc_l1"]
    page = (out / "report" / "report.html").read_text(encoding="utf-8")
    assert "Calibrated blocks" in page
    for outside in ('src="http', "src='http", 'href="http'):
        assert outside not in page
    for name in ("press.json", "signals.npz", "gel.vtu", "image.png", "scene.png"):
        assert (out / "press" / name).stat().st_size > 100
    press = json.loads((out / "press" / "press.json").read_text())
    assert press["path"]["depth_mm"] == 0.4 and press["press"]["force_n"] > 0


def test_interrupted_in_the_middle(
    captures: Path, out: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("taccel_lab.calibration.color.fit.layer_skirts", interrupt)
    before = everything_below(out)
    for folder in (tmp_path / "new" / "demo", out):
        assert run("demo", "--captures", captures, "--out", folder) == 130
        kept = folder.with_name("demo_unfinished")
        assert load_profile(kept / "profile").background is not None
        assert sorted(os.listdir(folder.parent)) == sorted(
            {kept.name} | ({"demo"} if folder == out else set())
        )
    assert everything_below(out) == before


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (str, "--depth-mm 5.2", "depth 5.2 mm goes past the gel, which is 5 mm thick"),
        (str, "--depth-mm -1", "depth must be above 0 mm"),
        (lambda text: text.replace('image = "p3.png"', 'image = "absent.png"'), "", "absent.png"),
    ],
)
def test_bad_input_is_refused_before_any_work(
    tmp_path: Path,
    forbid: Callable[[str], None],
    cli: Cli,
    change: Callable[[str], str],
    options: str,
    words: str,
) -> None:
    folder = write_captures(tmp_path / "captures")
    manifest = folder / "captures.toml"
    manifest.write_text(change(manifest.read_text()))
    forbid("taccel_lab.calibration.calibrate.calibrate")
    out = ["--out", tmp_path / "demo", *options.split()]
    told = cli.refusal("demo --captures", folder, *out)
    assert words in told and (options or str(folder) in told)
    assert os.listdir(tmp_path) == ["captures"]


def test_a_kill_in_the_middle_keeps_what_is_finished(captures: Path, tmp_path: Path) -> None:
    """Killed while colours are fitted, the same command goes on after the background."""
    out, kept = tmp_path / "demo", tmp_path / "demo_unfinished"
    words = ["demo", "--captures", str(captures), "--out", str(out), "--depth-mm", "0.3"]
    command = [sys.executable, "-m", "taccel_lab.cli.app", *words, "--only", "background", "color"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as running:
        page = kept / "report" / "background" / "report.html"
        until = time.monotonic() + 120
        while not (page.is_file() and (kept / "calibration.json").is_file()):
            assert running.poll() is None and time.monotonic() < until
            time.sleep(0.02)
        running.kill()
    assert running.returncode == -signal.SIGKILL and not out.exists()
    assert list(json.loads((kept / "calibration.json").read_text())["blocks"]) == ["background"]
    assert load_profile(kept / "profile").background is not None
    made = page.read_bytes(), page.stat().st_mtime_ns

    assert run(*words, "--only", "background", "color") == 0
    page = out / "report" / "background" / "report.html"
    assert (page.read_bytes(), page.stat().st_mtime_ns) == made
    assert load_profile(out / "profile").color is not None and (out / "press").is_dir()
    assert not kept.exists()
