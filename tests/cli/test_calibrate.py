# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: ``color`` with simulated presses, ``camera``, ``scale`` and ``all``."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.blocks import BLOCKS
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.cli.calibrate.blocks import BLOCK_COMMANDS
from taccel_lab.errors import InputError
from taccel_lab.profile import load_profile
from tests.calibration.drawn.boards import chess_pattern, dot_pattern, pose_over, render_board
from tests.calibration.drawn.faults import add_noise, quantise
from tests.calibration.scale.test_agreement import write_folder
from tests.cli.conftest import Cli
from tests.support.small_captures import GRID, everything_below, write_captures, write_profile


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


def test_every_block_has_a_command() -> None:
    assert {block.name for block in BLOCKS} == set(BLOCK_COMMANDS)


# All ---------------------------------------------------------------------------------------------


def test_profile_and_reports_are_written(captures: Path, tmp_path: Path, cli: Cli) -> None:
    out, blocks = tmp_path / "unit", ["--only", "background", "markers", "spread"]
    shown = cli.json("calibrate all", captures, "--out", out, *blocks)["blocks"]
    assert [(s["name"], s["state"]) for s in shown] == [
        ("background", "done"),
        ("markers", "skipped"),
        ("spread", "done"),
    ]
    assert load_profile(out).perturbation is not None
    report = tmp_path / "unit_report"
    assert (report / "background" / "report.html").is_file()
    assert (report / "report.html").is_file()
    assert not list(tmp_path.glob(".*"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["captures", "unit", "unit_report"]


def test_the_report_may_be_the_folder_one_is_in(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def kill(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    words = [captures, "--out", tmp_path / "unit", "--report", ".", "--only"]
    blocks = tuple(replace(b, verb=kill) if b.name == "spread" else b for b in BLOCKS)
    with monkeypatch.context() as patch:
        patch.setattr("taccel_lab.calibration.calibrate.BLOCKS", blocks)
        told = cli("calibrate all", *words, "background", "spread", code=130).err
    assert "finished blocks are kept" in told and "here_unfinished" in told.replace("\n", "")
    cli("calibrate all", *words, "background", "spread")
    assert (tmp_path / "here" / "background" / "report.html").is_file()
    assert not (tmp_path / "here_unfinished").exists()


def test_a_block_that_refuses_ends_with_1(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("the light is off")

    blocks = tuple(replace(b, verb=refuse) if b.name == "background" else b for b in BLOCKS)
    monkeypatch.setattr("taccel_lab.calibration.calibrate.BLOCKS", blocks)
    words = [captures, "--out", tmp_path / "unit", "--only", "background", "spread"]
    assert "the light is off" in cli("calibrate all", *words, code=1).out
    assert load_profile(tmp_path / "unit").perturbation is not None


def test_nothing_to_do_writes_nothing(captures: Path, tmp_path: Path, cli: Cli) -> None:
    words = [captures, "--out", tmp_path / "unit", "--only", "markers"]
    assert "nothing could be calibrated" in cli.refusal("calibrate all", *words)
    assert [path.name for path in tmp_path.iterdir()] == ["captures"]


# Color -------------------------------------------------------------------------------------------


def test_captures_become_a_profile_that_can_be_pressed(
    captures: Path, tmp_path: Path, cli: Cli
) -> None:
    out = tmp_path / "calibrated" / "unit"
    options = ("--steps", "150", "--drift", "off", "--json")
    captured = cli("calibrate color", captures, "--out", out, *options)
    color = json.loads(captured.out)["color"]
    for key in ("crop_psnr_db", "crop_ssim", "disc_l1", "full_l1"):
        assert np.isfinite(color["heldout"][key]) and np.isfinite(color["background_only"][key])
    assert color["heldout"]["disc_l1"] < 0.6 * color["background_only"]["disc_l1"]
    assert color["heldout"]["crop_psnr_db"] > color["background_only"]["crop_psnr_db"] + 3
    assert [row["name"] for row in color["presses"]] == ["p0"]

    profile = load_profile(out)
    assert profile.grid() == GRID
    assert profile.color is not None
    assert "bonded layer of 5 mm" in profile.color.provenance.method
    assert set(profile.color.provenance.inputs) >= {"background", "p1", "p2", "p3", "p4"}
    assert sorted(os.listdir(out.parent)) == ["unit", "unit_report"]

    pressed = tmp_path / "press"
    cli("press", out, "--out", pressed, "--depth-mm", "0.4")
    with np.load(pressed / "signals.npz") as signals:
        rgb, mask = signals["rgb"].astype(float), signals["contact_mask"]
    # Lamp 0 shines along x: the red of left and right flanks of the dent lies on either side.
    background = profile.background_rgb
    assert background is not None
    change = (rgb - background)[..., 0]
    x = np.broadcast_to(GRID.x_mm(), mask.shape)
    left, right = change[mask & (x < -0.3)].mean(), change[mask & (x > 0.3)].mean()
    assert left * right < 0 and min(abs(left), abs(right)) > 3


def test_base_profile_gives_the_design(captures: Path, tmp_path: Path, cli: Cli) -> None:
    base = write_profile(tmp_path / "base", color=False)
    out = tmp_path / "unit"
    options = ["--base", base, "--steps", "5", "--holdout-every", "0"]
    for _ in range(2):  # Again, in the place of the first.
        cli("calibrate color", captures, "--out", out, *options)
        assert load_profile(out).material == load_profile(base).material
        assert sorted(os.listdir(tmp_path)) == ["base", "captures", "unit", "unit_report"]


def test_an_interrupted_calibration_leaves_the_earlier_profile(
    captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    out = write_profile(tmp_path / "unit")
    before = everything_below(tmp_path)
    monkeypatch.setattr("taccel_lab.calibration.color.fit.layer_skirts", interrupt)
    cli("calibrate color", captures, "--out", out, code=130)
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


def test_boards_to_profile_report_and_maps(base: Path, tmp_path: Path, cli: Cli) -> None:
    words = [write_boards(tmp_path / "captures"), "--base", base]
    out, maps = tmp_path / "out", tmp_path / "maps.npz"
    words += ["--maps", maps, "--models", "k1", "--folds", "2", "--refraction", "none"]
    figures = cli.json("calibrate camera", *words, "--out", out)["camera"]
    assert figures["intrinsics"]["heldout_rms_px"] < 0.3
    profile = load_profile(out)
    camera, optics = profile.camera, profile.optics
    assert camera.provenance.kind == "calibrated" and camera.provenance.verdict is not None
    # The board is 24 mm away: a pixel spans 24 / f there.
    assert camera.mm_per_px_x == pytest.approx(24.0 / 270.0, rel=0.01)
    assert optics is not None and optics.provenance.kind == "calibrated"
    assert optics.fx_px == pytest.approx(270.0, abs=5 * optics.provenance.spread["fx_px"] + 1)
    assert optics.position_mm[2] == pytest.approx(-24.0, rel=0.02)
    assert optics.distortion[0] == pytest.approx(-0.1, abs=0.05)
    with np.load(maps) as stored:
        assert stored["map_u_px"].shape == (240, 320)
    report = tmp_path / "out_report"
    pictures = {"views", "residuals", "distortion", "board_on_gel", "rectified"}
    assert pictures <= {path.stem for path in report.glob("*.png")}
    assert json.loads((report / "report.json").read_text())["verdict"] in ("good", "usable")


def test_a_board_that_contradicts_the_stated_scale(base: Path, tmp_path: Path, cli: Cli) -> None:
    captures = write_boards(tmp_path / "captures")
    manifest = captures / "captures.toml"
    text = manifest.read_text(encoding="utf-8").replace(HEADER[1], HEADER[1] + STATED)
    boards = text.split("[[boards]]")
    manifest.write_text(f"{boards[0]}[[boards]]{boards[2]}", encoding="utf-8")
    done = cli("calibrate camera", captures, "--base", base, "--out", tmp_path / "out")
    said = " ".join(done.err.split())
    assert "the captures state mm_per_px_x = 0.2, measured is" in said
    assert "mm_per_px_y = " not in said


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
