# SPDX-License-Identifier: Apache-2.0
"""``calibrate camera`` and ``calibrate scale`` from folder to profile, report and maps."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.cli.app import main
from taccel_lab.profile import load_profile
from tests.calibration.drawn.boards import (
    chess_pattern,
    dot_pattern,
    pose_over,
    render_board,
)
from tests.calibration.drawn.faults import add_noise, quantise
from tests.calibration.scale.test_agreement import write_folder
from tests.support.small_captures import write_profile

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


def test_boards_to_profile_report_and_maps(
    base: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    captures = write_boards(tmp_path / "captures")
    out, maps = tmp_path / "out", tmp_path / "maps.npz"
    code = main([
        "calibrate", "camera", str(captures), "--out", str(out), "--base", str(base),
        "--maps", str(maps), "--models", "k1", "--folds", "2", "--refraction", "none", "--json",
    ])  # fmt: skip
    assert code in (0, None)
    figures = json.loads(capsys.readouterr().out)["camera"]
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


def test_a_board_that_contradicts_the_stated_scale(
    base: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    captures = write_boards(tmp_path / "captures")
    manifest = captures / "captures.toml"
    text = manifest.read_text(encoding="utf-8").replace(HEADER[1], HEADER[1] + STATED)
    boards = text.split("[[boards]]")
    manifest.write_text(f"{boards[0]}[[boards]]{boards[2]}", encoding="utf-8")
    arguments = ["calibrate", "camera", str(captures), "--base", str(base)]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "the captures state mm_per_px_x = 0.2, measured is" in said
    assert "mm_per_px_y = " not in said


def test_known_lengths_to_profile(base: Path, tmp_path: Path) -> None:
    captures = write_folder(tmp_path / "captures", (0.085, 0.082))
    out = tmp_path / "out"
    main(["calibrate", "scale", str(captures), "--out", str(out), "--base", str(base)])
    camera = load_profile(out).camera
    assert camera.mm_per_px_x == pytest.approx(0.085, rel=0.02)
    assert camera.mm_per_px_y == pytest.approx(0.082, rel=0.02)
    assert camera.provenance.interval["mm_per_px_x"][0] < 0.085
    assert (tmp_path / "out_report" / "estimates.png").is_file()


@pytest.mark.parametrize("command", ["camera", "scale"])
def test_folders_without_either_are_refused_whole(
    command: str, base: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
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
    code = main(["calibrate", command, str(captures), "--out", str(out), "--base", str(base)])
    assert code == 2 and not out.exists() and not (tmp_path / "out_report").exists()
    said = capsys.readouterr().err
    assert ("found 0 of 35" if command == "camera" else "nothing of known length") in said
