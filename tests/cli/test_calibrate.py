# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: colours with simulated presses, camera, scale, material and all."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import force_table
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.cli.calibrate import BLOCK_COMMANDS
from taccel_lab.errors import InputError
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from tests.calibration.drawn.boards import chess_pattern, dot_pattern, pose_over, render_board
from tests.calibration.drawn.faults import add_noise, quantise
from tests.calibration.scale.test_agreement import write_folder
from tests.cli.conftest import Cli
from tests.support.small_captures import (
    everything_below,
    fit_colors_as_backgrounds,
    write_captures,
    write_profile,
)
from tests.support.synthetic_presses import without_check


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


def test_every_block_has_a_command() -> None:
    assert {block.name for block in BLOCKS} == set(BLOCK_COMMANDS)


@pytest.mark.thorough
def test_one_camera_of_several_is_calibrated_and_put_back(
    captures: Path, tmp_path: Path, cli: Cli
) -> None:
    """The other camera, whose images have another size, stays as it is."""
    right = load_profile(write_profile(tmp_path / "right", color=False))
    left = catalogue_profile("gelsight").without("background")
    save_profile(left.with_view("right", right), tmp_path / "pair")
    words = ["--base", f"{tmp_path / 'pair'}@right", "--out", tmp_path / "unit"]
    cli("calibrate background", captures, *words)
    unit = load_profile(tmp_path / "unit")
    assert unit.background_rgb is not None and unit.view_names() == ("main",)
    pair = str(tmp_path / "pair")
    cli("profile add-view", pair, "right", tmp_path / "unit", "--out", pair)
    again = load_profile(tmp_path / "pair")
    assert again.background_rgb is None and again.grid() == left.grid()
    np.testing.assert_array_equal(again.seen_by("right").background_rgb, unit.background_rgb)


# All ---------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_block_that_refuses_ends_with_1(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("the light is off")

    fit_colors_as_backgrounds(monkeypatch)
    fit = "taccel_lab.calibration.light.background.calibrate_background"
    monkeypatch.setattr(fit, refuse)
    # The report may be the folder one is in.
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    words = [captures, "--out", tmp_path / "unit", "--report", "."]
    words += ["--only", "background", "color", "markers"]
    shown = cli.json("calibrate all", *words, code=1)["blocks"]
    assert {s["name"]: s["state"] for s in shown} == {
        "background": "refused", "color": "done", "markers": "skipped",
    }  # fmt: skip
    assert any("the light is off" in json.dumps(block) for block in shown)
    assert load_profile(tmp_path / "unit").perturbation is not None
    assert (tmp_path / "here" / "color" / "report.html").is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captures", "here", "unit"]


def test_nothing_to_do_writes_nothing(captures: Path, tmp_path: Path, cli: Cli) -> None:
    words = [captures, "--out", tmp_path / "unit", "--only", "markers"]
    assert "nothing could be calibrated" in cli.refusal("calibrate all", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["captures"]


# Color -------------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_base_profile_gives_the_design(captures: Path, tmp_path: Path, cli: Cli) -> None:
    base = write_profile(tmp_path / "base", color=False)
    out = tmp_path / "unit"
    options = ["--base", base, "--steps", "5", "--holdout-every", "0"]
    cli("calibrate background", captures, "--out", out)
    # In the place of the profile and the report of before.
    cli("calibrate color", captures, "--out", out, *options)
    assert load_profile(out).color is not None
    assert load_profile(out).material == load_profile(base).material
    assert sorted(os.listdir(tmp_path)) == ["base", "captures", "unit", "unit_report"]


@pytest.mark.thorough
def test_an_interrupted_calibration_leaves_the_earlier_profile(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = write_profile(tmp_path / "unit")
    before = everything_below(tmp_path)
    without_check(monkeypatch)
    monkeypatch.setattr("taccel_lab.calibration.color.fit.fit_color_model", interrupt)
    cli("calibrate color", captures, "--out", out, "--steps", "5", code=130)
    assert everything_below(tmp_path) == before


# Camera and scale --------------------------------------------------------------------------------

LENS, SIZE = LENSES["k1"], (320, 240)
PARAMETERS = np.array([270.0, 268.0, 158.0, 121.0, -0.1])
STATED = "\nmm_per_px_x = 0.2\nmm_per_px_y = 0.0896"
HEADER = ["schema_version = 2", 'sensor = "gelsight"']


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("profile")
    write_profile(folder / "profile")
    return folder / "profile"


def save(path: Path, pattern, pose: np.ndarray, pitch_mm: float) -> None:
    image = render_board(LENS, PARAMETERS, pose, SIZE, pattern, pitch_mm, samples=2)
    noisy = quantise(add_noise(image, 1.5, np.random.default_rng(len(path.name))))
    cv2.imwrite(str(path), noisy[..., ::-1])


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_boards(tmp_path_factory.mktemp("boards") / "captures")


def write_boards(folder: Path) -> Path:
    """Six chessboards in air, and a board of dots on the gel 24 mm before the camera."""
    folder.mkdir(parents=True)
    tilts = [(25, 0), (-25, 10), (5, 28), (0, -28), (20, 20), (-15, -20)]
    for k, tilt in enumerate(tilts):
        pose = pose_over(7, 5, 4.0, distance_mm=40 + 2 * k, tilt_deg=tilt, turn_deg=20.0 * k)
        save(folder / f"view_{k}.png", chess_pattern(7, 5), pose, 4.0)
    pose = pose_over(9, 7, 2.0, distance_mm=24.0, tilt_deg=(2.0, -1.0), turn_deg=3.0)
    save(folder / "gel.png", dot_pattern(9, 7), pose, 2.0)
    names = ", ".join(f'"view_{k}.png"' for k in range(len(tilts)))
    lines = [*HEADER, "[[boards]]", 'kind = "chessboard"', "columns = 7", "rows = 5"]
    lines += [f"images = [{names}]", "[[boards]]", 'kind = "dots"', "columns = 9", "rows = 7"]
    lines += ["pitch_mm = 2.0", "on_gel = true", 'images = ["gel.png"]']
    (folder / "captures.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.mark.thorough
def test_boards_to_profile_report_and_maps(
    boards: Path, base: Path, tmp_path: Path, cli: Cli
) -> None:
    words = [boards, "--base", base]
    out, maps = tmp_path / "out", tmp_path / "maps.npz"
    words += ["--maps", maps, "--models", "k1", "--folds", "2"]
    figures = cli.json("calibrate camera", *words, "--out", out)["camera"]
    assert figures["intrinsics"]["heldout_rms_px"] < 0.3
    profile = load_profile(out)
    camera, optics = profile.camera, profile.optics
    assert camera.provenance.kind == "calibrated" and camera.provenance.verdict is not None
    # The board is 24 mm away: a pixel spans 24 / f there.
    assert camera.mm_per_px_x == pytest.approx(24.0 / 270.0, rel=0.01)
    assert optics is not None and optics.provenance.kind == "calibrated"
    assert optics.fx_px == pytest.approx(270.0, abs=5 * optics.provenance.spread["fx_px"] + 1)
    # Drawn in air: of both poses in the report, that of straight sight lines.
    (straight,) = (p for p in figures["on_gel"]["poses"] if not p["refracted"])
    assert straight["position_mm"][2] == pytest.approx(-24.0, rel=0.02)
    assert optics.distortion[0] == pytest.approx(-0.1, abs=0.05)
    with np.load(maps) as stored:
        assert stored["map_u_px"].shape == (240, 320)
    report = tmp_path / "out_report"
    pictures = {"views", "residuals", "board_on_gel", "rectified"}
    assert pictures <= {path.stem for path in report.glob("*.png")}
    assert json.loads((report / "report.json").read_text())["verdict"] in ("good", "usable")


@pytest.mark.thorough
def test_a_board_that_contradicts_the_stated_scale(
    boards: Path, base: Path, tmp_path: Path, cli: Cli
) -> None:
    captures = shutil.copytree(boards, tmp_path / "captures")
    manifest = captures / "captures.toml"
    text = manifest.read_text(encoding="utf-8").replace(HEADER[1], HEADER[1] + STATED)
    parts = text.split("[[boards]]")
    manifest.write_text(f"{parts[0]}[[boards]]{parts[2]}", encoding="utf-8")
    done = cli("calibrate camera", captures, "--base", base, "--out", tmp_path / "out")
    said = " ".join(done.err.split())
    assert "the captures state mm_per_px_x = 0.2, measured is" in said
    assert "mm_per_px_y = " not in said


@pytest.mark.thorough
def test_known_lengths_to_profile(base: Path, tmp_path: Path, cli: Cli) -> None:
    captures = write_folder(tmp_path / "captures", (0.085, 0.082))
    out = tmp_path / "out"
    cli("calibrate scale", captures, "--out", out, "--base", base)
    camera = load_profile(out).camera
    assert camera.mm_per_px_x == pytest.approx(0.085, rel=0.02)
    assert camera.mm_per_px_y == pytest.approx(0.082, rel=0.02)
    assert camera.provenance.interval["mm_per_px_x"][0] < 0.085
    assert (tmp_path / "out_report" / "estimates.png").is_file()


@pytest.mark.parametrize("command", ["camera", "scale"])
def test_folders_without_either_are_refused_whole(
    command: str, base: Path, tmp_path: Path, cli: Cli
) -> None:
    captures = tmp_path / "captures"
    captures.mkdir()
    image = np.full((240, 320, 3), 90, np.uint8)
    cv2.imwrite(str(captures / "b.png"), image)
    lines = [*HEADER, 'background = "b.png"']
    if command == "camera":
        lines += ["[[boards]]", 'kind = "chessboard"', "columns = 7", "rows = 5"]
        lines += ['images = ["b.png"]']
    (captures / "captures.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    said = cli.refusal(f"calibrate {command}", captures, "--out", out, "--base", base)
    assert not out.exists() and not (tmp_path / "out_report").exists()
    assert ("no board was found" if command == "camera" else "nothing of known length") in said


MODULUS, POISSON, FRICTION = 3e5, 0.47, 0.5
DEPTH = np.linspace(0.15, 1.2, 10)
FAST = PressPhysics(Accuracy.FAST, mesh=PressMeshOptions(elements_per_radius=2.0, core=4, rings=6))
"""Quicker than what a user gets."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def record_captures(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A press."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(cache))
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, FAST)
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    gel = Gel.of_profile(catalogue_profile("gelsight_mini"), physics=FAST).with_law(POISSON)
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=5.0))
    table = force_table(gel, tool, (0.15, 1.2), free_nu=False, friction=FRICTION)
    force = table.force_n(DEPTH, MODULUS, POISSON)
    rng = np.random.default_rng(0)
    folder = tmp_path / "captures"
    folder.mkdir()
    write(folder / "press.csv", depth_mm=DEPTH, force_n=force * (1 + 0.01 * rng.normal(size=10)))
    manifest(folder)
    return folder


def write(path: Path, **columns: np.ndarray) -> None:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")


def manifest(folder: Path, press_mm: float = 5.0) -> None:
    (folder / "captures.toml").write_text(
        'schema_version = 2\nsensor = "gelsight_mini"\nsource = "test"\n'
        '[[records]]\nfile = "press.csv"\nkind = "indentation"\n'
        f'tool = {{ kind = "sphere", radius_mm = {press_mm} }}\n'
    )


def words(record_captures: Path) -> list[object]:
    out = record_captures.parent / "profile"
    return [
        record_captures,
        "--out",
        out,
        "--accuracy",
        "fast",
        "--fix",
        f"nu={POISSON}",
        f"friction={FRICTION}",
    ]


@pytest.mark.thorough
def test_records_become_a_profile_and_a_report(record_captures: Path, cli: Cli) -> None:
    printed = cli.json("calibrate material", *words(record_captures))["material"]
    assert printed["verdict"] == "good"
    profile = load_profile(record_captures.parent / "profile")
    block = profile.material
    low, high = block.provenance.interval["young_modulus_pa"]
    assert low < MODULUS < high and high / low < 1.3
    assert block.young_modulus_pa == pytest.approx(MODULUS, rel=0.02)
    assert block.friction_coefficient == FRICTION
    assert block.poisson_ratio == POISSON
    assert block.fitted_with is not None and not block.fitted_with.friction_measured
    assert block.fitted_with.friction_coefficient == block.friction_coefficient
    assert block.fitted_with.physics["accuracy"] == "fast"
    assert block.provenance.kind == "calibrated" and block.provenance.verdict == "good"
    assert set(block.provenance.inputs) == {"press.csv", "captures.toml"}
    residuals = block.provenance.residuals
    assert next(iter(residuals)) == "indentation_held_out_worst_relative"
    assert residuals["indentation_worst_relative"] < 0.04
    assert residuals["indentation_held_out_worst_relative"] < 0.06
    assert block.provenance.valid_region["depth_mm"] == pytest.approx((0.15, 1.2))
    report = record_captures.parent / "profile_report"
    assert (report / "report.html").is_file() and (report / "indentation.png").is_file()
    assert json.loads((report / "report.json").read_text())["held"] == {
        "friction_coefficient": FRICTION, "poisson_ratio": POISSON,
    }  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--fix", "nu"), "name=value"),
        (("--fix", "stiffness=3"), "cannot be held"),
        (("--fix", "mooney_ratio=0.2"), "--model mooney_rivlin"),
        (("--fix", "friction=7"), "friction must lie in [0, 5]"),
    ],
)
def test_bad_options_are_refused(
    record_captures: Path, cli: Cli, options: tuple[str, ...], told: str
) -> None:
    assert told in cli.refusal("calibrate material", *words(record_captures), *options)


@pytest.mark.thorough
def test_captures_without_forces_say_what_is_needed(record_captures: Path, cli: Cli) -> None:
    (record_captures / "captures.toml").write_text('schema_version = 2\nsensor = "gelsight_mini"\n')
    assert "[[records]]" in cli.refusal("calibrate material", *words(record_captures))
