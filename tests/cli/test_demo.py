# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job end to end, on captures small enough for a test."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.output_folder import OUTPUT_MARKER
from taccel_lab.profile import load_profile, validate_profile
from tests.cli.conftest import Cli
from tests.geometry.vtu_files import read_mesh_vtu
from tests.support.commands import run
from tests.support.small_captures import CIRCLES, GRID, everything_below, write_captures

HELDOUT = ("p0",)
"""By the rule of ``taccel_lab.calibration.capture.split``."""


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_captures(tmp_path_factory.mktemp("demo") / "captures")


@pytest.fixture(scope="module")
def out(captures: Path) -> Path:
    """Output of one demo."""
    folder = captures.parent / "out" / "demo"
    arguments = ["--captures", captures, "--out", folder]
    assert run("demo", *arguments, "--steps", "50", "--depth-mm", "0.4") == 0
    return folder


@pytest.fixture(scope="module")
def values(out: Path) -> dict[str, Any]:
    return json.loads((out / "report.json").read_text())


def test_everything_is_there(out: Path) -> None:
    assert {path.name for path in out.iterdir()} == {
        OUTPUT_MARKER, "design", "figures", "press", "profile", "report.html", "report.json",
    }  # fmt: skip
    assert os.listdir(out.parent) == ["demo"]
    for name in ("pad.step", "pad.stl", "pad.vtu", "quality.json"):
        assert (out / "design" / name).stat().st_size > 100
    for name in ("press.json", "signals.npz", "gel.vtu", "image.png"):
        assert (out / "press" / name).stat().st_size > 100


def test_color_figures(values: dict[str, Any]) -> None:
    color = values["color"]
    for group in ("heldout", "background_only"):
        for key in ("crop_psnr_db", "crop_ssim", "disc_l1", "full_l1"):
            assert math.isfinite(color[group][key]), (group, key)
    assert color["heldout"]["disc_l1"] < color["background_only"]["disc_l1"]
    assert color["heldout_count"] == 1 and color["train_count"] == len(CIRCLES) - 1
    assert [frame["name"] for frame in color["frames"]] == list(HELDOUT)
    assert color["facts"]["held-out presses"] == "placed by label"


def test_press_figures(values: dict[str, Any], out: Path) -> None:
    press = values["press"]
    assert press["force_n"] > 0
    assert 0 <= press["residual_n"] < 1e-3 * press["force_n"]
    assert press["newton_iterations"] >= 1 and press["seconds_per_step"] > 0
    assert 0 < press["min_distance_m"] < 2e-5
    fitted = {f"p{i}": circle for i, circle in enumerate(CIRCLES) if f"p{i}" not in HELDOUT}
    assert [record["name"] for record in press["records"]] == list(fitted)
    for record, circle in zip(press["records"], fitted.values(), strict=True):
        assert record["contact_radius_mm"] == pytest.approx(
            circle.radius_px * GRID.mm_per_px_x, abs=0.1
        )
    alone = json.loads((out / "press" / "press.json").read_text())
    assert alone["press"]["force_n"] == press["force_n"]
    assert alone["path"]["depth_mm"] == 0.4


def test_mesh_figures(values: dict[str, Any], out: Path) -> None:
    mesh = read_mesh_vtu(out / "design" / "pad.vtu")
    assert values["mesh"]["node_count"] == mesh.node_count
    assert values["mesh"]["tet_count"] == mesh.tet_count
    assert 5 < values["mesh"]["min_dihedral_deg"] < 71


def test_verdict_and_targets(values: dict[str, Any]) -> None:
    keys = {target["key"] for target in values["targets"]}
    assert keys == {f"color.heldout.{k}" for k in ("crop_psnr_db", "crop_ssim", "disc_l1")}
    for target in values["targets"]:
        value = values["color"]["heldout"][target["key"].rsplit(".", 1)[1]]
        assert target["value"] == value
        better = value >= target["goal"] if target["at_least"] else value <= target["goal"]
        assert target["met"] == better
    assert values["verdict"]
    assert values["total_s"] == pytest.approx(sum(values["timings_s"].values()))


def test_page_is_self_contained(out: Path) -> None:
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 5
    for outside in ('src="http', "src='http", 'href="http', 'src="figures'):
        assert outside not in page


def test_profile_is_sound(out: Path) -> None:
    assert validate_profile(out / "profile") == []
    profile = load_profile(out / "profile")
    assert profile.color is not None and profile.background_rgb is not None
    assert profile.grid() == GRID
    assert run("profile", "validate", out / "profile") == 0


def test_interrupted_in_the_middle(
    captures: Path, out: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("taccel_lab.calibration.simulate.simulate_presses", interrupt)
    before = everything_below(out.parent)
    for folder in (tmp_path / "new" / "demo", out):
        assert run("demo", "--captures", captures, "--out", folder) == 130
    assert everything_below(tmp_path) == {}
    assert everything_below(out.parent) == before


def four_presses(manifest: str) -> str:
    return "[[presses]]".join(manifest.split("[[presses]]")[:4])


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (str, "--steps 0", "steps must be at least 1, got 0"),
        (str, "--depth-mm 5.2", "depth 5.2 mm goes past the gel, which is 5 mm thick"),
        (str, "--depth-mm -1", "depth must be above 0 mm"),
        (lambda text: text.replace('"gelsight"', '"digit"'), "", "captured with sensor 'digit'"),
        (lambda text: text.replace('image = "p3.png"', 'image = "absent.png"'), "", "absent.png"),
        (four_presses, "", "holds 3 presses, too few"),
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
    forbid("taccel_lab.sensors.design.design_sensor")
    out = ["--out", tmp_path / "demo", *options.split()]
    told = cli.refusal("demo --captures", folder, *out)
    assert words in told and (options or str(folder) in told)
    assert os.listdir(tmp_path) == ["captures"]
