# SPDX-License-Identifier: Apache-2.0
"""Markers of capture folders, from captures to a profile."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.calibration.markers.tracks import track_figures
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import load_profile, save_profile
from tests.calibration.drawn.dot_grids import HEIGHT, WIDTH, grid_points, picture
from tests.support.commands import refusal, run
from tests.support.real_data import real_data
from tests.support.synthetic_presses import tiny_profile

BOARD = "9dtact_official/shape_reconstruction/calibration/sensor_1/camera_calibration"


def real(name: str) -> np.ndarray:
    return read_image(real_data(name))


@pytest.mark.thorough(
    cases=(
        "9dtact_official/shape_reconstruction/calibration/sensor_1/camera_calibration/sample.png-7-9-63",
        "backgrounds_misc/difftactile_init.png-14-10-134",
        "gelslim_mcubelab/reconstruction/images/reconstruct_0.jpg-14-19-250",
    )
)
@pytest.mark.parametrize(
    ("name", "rows", "columns", "least"),
    [
        ("gsmini_markers_video/0000.png", 8, 10, 78),
        ("fots_calib/marker_calib/data/0.png", 9, 11, 97),
        ("gsmini_feats_calib/src/feats/homography/cuboid_10-2-284.png", 7, 9, 63),
        ("gelslim_mcubelab/reconstruction/images/reconstruct_0.jpg", 14, 19, 250),
        ("backgrounds_misc/difftactile_init.png", 14, 10, 134),
        (f"{BOARD}/sample.png", 7, 9, 63),
    ],
)
def test_dots_of_real_sensors_are_numbered(name: str, rows: int, columns: int, least: int) -> None:
    found = find_markers(real(name))
    assert (found.lattice.rows, found.lattice.columns) == (rows, columns)
    assert found.lattice.numbered.sum() >= least
    # Bent by the lens: the board by most, a 7th of the corner's distance from the middle.
    assert found.lattice.irregularity < 0.08


@pytest.mark.parametrize(
    "name",
    [
        "backgrounds_misc/maniskill_vitac_gsmini_bg.png",
        "backgrounds_misc/tacsl_gelsight_r15_data_bg.jpg",
        "backgrounds_misc/fabprez_gsmini_ball.png",
        "fots_calib/mlp_calib/gelsight/0001.png",
        "fots_calib/assets/gel/digit_bg.png",
        "gelslim_mcubelab/updated_calib/ref.jpg",
        "gelsight_rvsathu_sim2real/background_real.png",
        "gsmini_gs_sdk/examples/data/bead.png",
        f"{BOARD}/ref.png",
    ],
)
def test_real_sensors_without_dots_have_none(name: str) -> None:
    with pytest.raises(InputError, match="no dots found"):
        find_markers(real(name))


def test_displacements_agree_with_a_peers_table() -> None:
    """FOTS's marker frame: resting places and displacements of 99 dots in whole pixels.

    Its numbers are cut, not rounded: found places lie half a pixel beyond them at the median.
    """
    image = real("fots_calib/marker_calib/data/0.png")
    table = np.loadtxt(real_data("fots_calib/marker_calib/data/0.csv"), delimiter=",", skiprows=1)
    rest, moved = table[:, :2] + 0.5, table[:, 2:]
    found = find_markers(image).dots
    whole = found.uv_px[found.whole]
    own = np.argmin(np.linalg.norm(whole[:, None] - (rest + moved)[None], axis=2), axis=1)
    assert len(set(own)) == len(own) >= 85
    error = np.linalg.norm(whole - rest[own] - moved[own], axis=1)
    assert np.median(error) <= 0.6


@pytest.mark.slow
def test_a_real_video_is_followed_to_the_end() -> None:
    frames = [real(f"gsmini_markers_video/{n:04d}.png") for n in range(121)]
    tracks = track_markers(frames, find_markers(frames[0]))
    figures = track_figures("video", tracks)
    still = tracks.uv_px[:54, tracks.seen[:54].all(axis=0)]
    assert np.median(still.std(axis=0, ddof=1)) <= 0.02
    assert figures.return_frame == 88
    assert figures.return_median_px is not None
    assert figures.return_median_px <= 0.6
    # Dots that stay in the picture are seen all the way.
    inner = ((tracks.rest_px > 25) & (tracks.rest_px < (295, 215))).all(axis=1)
    assert tracks.seen[:, inner].all()


@pytest.mark.thorough
def test_part_of_a_real_video_is_followed() -> None:
    frames = [real(f"gsmini_markers_video/{n:04d}.png") for n in (0, *range(56, 90, 2))]
    tracks = track_markers(frames, find_markers(frames[0]))
    inner = ((tracks.rest_px > 25) & (tracks.rest_px < (295, 215))).all(axis=1)
    assert tracks.seen[:, inner].all()
    distance = tracks.distance_px()
    assert np.nanmax(distance) > 10.0
    assert np.nanmedian(distance[-1]) <= 0.7


PITCH_MM = 1.8
SCALE = 0.06


@pytest.fixture
def base(tmp_path: Path) -> Path:
    save_profile(tiny_profile(PixelGrid(WIDTH, HEIGHT, 0.07, 0.07)), tmp_path / "base")
    return tmp_path / "base"


def write_captures(folder: Path, manifest: str, centres: list[np.ndarray]) -> Path:
    folder.mkdir()
    for number, points in enumerate(centres):
        image = picture(points, 5.0, noise=1.0, seed=number)
        assert cv2.imwrite(str(folder / f"{number:03d}.png"), image)
    text = f'schema_version = 2\nsensor = "gelsight"\n{manifest}'
    (folder / "captures.toml").write_text(text, encoding="utf-8")
    return folder


def moving(frames: int = 7) -> list[np.ndarray]:
    rest = grid_points(pitch=(30.0, 30.0), turn_rad=0.02)
    sway = [np.sin(np.pi * t / (frames - 1)) for t in range(frames)]
    return [rest, *[rest + (12.0 * s, -5.0 * s) for s in sway]]


VIDEO = """
mm_per_px_x = 0.06
mm_per_px_y = 0.06
[markers]
rest = "000.png"
[[markers.videos]]
frames = ["00[1-7].png"]
fps = 20.0
motion = "shear"
"""


def calibrate(*words: object) -> int:
    return run("calibrate", "markers", *words)


@pytest.mark.thorough
def test_captures_become_a_block_a_report_and_tracks(
    tmp_path: Path, base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_captures(tmp_path / "captures", VIDEO, moving())
    out, tracks = tmp_path / "profile", tmp_path / "tracks.npz"
    assert calibrate(folder, "--out", out, "--base", base, "--tracks", tracks, "--json") == 0
    figures = json.loads(capsys.readouterr().out)["markers"]
    block = load_profile(out).markers
    assert block is not None
    assert (block.rows, block.columns) == (7, 9)
    assert block.pitch_x_mm == pytest.approx(PITCH_MM, abs=1e-3)
    assert block.rotation_deg == pytest.approx(np.degrees(0.02), abs=0.02)
    assert block.radius_mm == pytest.approx(5.0 * SCALE, rel=0.03)
    assert block.offset_mm[0] == pytest.approx((159.3 - 159.5) * SCALE, abs=2e-3)
    provenance = block.provenance
    assert provenance.kind == "calibrated"
    assert provenance.verdict == "good"
    assert set(provenance.inputs) == {"000.png", "captures/001.png", "captures.toml"}
    assert abs(block.pitch_x_mm - PITCH_MM) < 4 * provenance.spread["pitch_x_mm"]
    assert figures["videos"][0]["seen_share"] == 1.0
    assert figures["videos"][0]["largest_px"] == pytest.approx(13.0, abs=0.1)
    page = (tmp_path / "profile_report" / "report.html").read_text(encoding="utf-8")
    assert "video0_tracks" in page or "Paths of the dots" in page
    arrays = np.load(tracks)
    assert arrays["video0_uv_px"].shape == (7, 63, 2)
    assert str(arrays["video0_name"]) == "captures/001.png"
    flow = arrays["video0_displacement_mm"]
    np.testing.assert_allclose(flow[3], [[12.0 * SCALE, -5.0 * SCALE]] * 63, atol=0.01)
    np.testing.assert_allclose(arrays["video0_time_s"], np.arange(7) / 20.0)


@pytest.mark.thorough
def test_the_radius_is_known_better_than_the_dots_differ(
    tmp_path: Path, base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The standard deviation of a median of 63, 1.25 spreads over the root of 63, and the scale's
    of 1 %."""
    folder = write_captures(tmp_path / "captures", VIDEO, moving())
    radii = np.random.default_rng(0).normal(5.0, 0.4, 63)
    rest = picture(moving()[0], radii, noise=1.0)
    assert cv2.imwrite(str(folder / "000.png"), rest)
    manifest = folder / "captures.toml"
    manifest.write_text(manifest.read_text().partition("[[markers.videos]]")[0])
    assert calibrate(folder, "--out", tmp_path / "profile", "--base", base, "--json") == 0
    found = json.loads(capsys.readouterr().out)["markers"]["estimates"]["radius_mm"]
    expected = np.hypot(1.2533 * 0.4 * SCALE / np.sqrt(63), 0.01 * 5.0 * SCALE)
    assert found["sigma"] == pytest.approx(expected, rel=0.3)


@pytest.mark.thorough
def test_tracks_are_written_as_tables(tmp_path: Path, base: Path) -> None:
    folder = write_captures(tmp_path / "captures", VIDEO, moving())
    tracks = tmp_path / "tracks.csv"
    assert calibrate(folder, "--out", tmp_path / "p", "--base", base, "--tracks", tracks) == 0
    with tracks.open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 7 * 63
    assert rows[-1]["status"] == "seen"
    assert float(rows[3 * 63]["dx_mm"]) == pytest.approx(12.0 * SCALE, abs=0.01)


def test_a_stated_pitch_gives_the_scale_and_missing_dots_are_kept(
    tmp_path: Path, base: Path
) -> None:
    manifest = '[markers]\nrest = "000.png"\npitch_x_mm = 1.8\n'
    left = np.delete(moving()[0], [2 * 9 + 3, 4 * 9 + 7], axis=0)
    folder = write_captures(tmp_path / "captures", manifest, [left])
    assert calibrate(folder, "--out", tmp_path / "p", "--base", base) == 0
    block = load_profile(tmp_path / "p").markers
    assert block is not None
    assert block.pitch_x_mm == pytest.approx(1.8, abs=1e-6)
    assert block.pitch_y_mm == pytest.approx(1.8, abs=2e-3)
    assert block.missing == ((2, 3), (4, 7))
    assert len(block.grid().points_mm()) == 61


@pytest.mark.thorough
def test_an_assumed_scale_and_a_contradiction_are_told(
    tmp_path: Path, base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rest = '[markers]\nrest = "000.png"\n'
    folder = write_captures(tmp_path / "assumed", rest, moving()[:1])
    assert calibrate(folder, "--out", tmp_path / "p", "--base", base) == 0
    assert "nobody measured" in " ".join(capsys.readouterr().err.split())
    both = "mm_per_px_x = 0.05\nmm_per_px_y = 0.05\n" + rest + "pitch_x_mm = 1.8\n"
    folder = write_captures(tmp_path / "both", both, moving()[:1])
    assert calibrate(folder, "--out", tmp_path / "q", "--base", base) == 0
    assert "+20.0 and +20.0 %" in " ".join(capsys.readouterr().err.split())


@pytest.mark.thorough
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(folder: Path, *more: object) -> str:
        out = tmp_path / "none"
        told = refusal(capsys, "calibrate", "markers", folder, "--out", out, "--base", base, *more)
        assert not out.exists()
        return told

    rest = '[markers]\nrest = "000.png"\n'
    nothing = write_captures(tmp_path / "nothing", rest, [np.empty((0, 2))])
    assert "no dots found" in refused(nothing)
    good = write_captures(tmp_path / "good", rest, moving()[:1])
    assert ".npz, .csv" in refused(good, "--tracks", tmp_path / "tracks.txt")
    bare = write_captures(tmp_path / "bare", "", moving()[:1])
    assert "no background" in refused(bare)
    video = rest + '[[markers.videos]]\nfile = "film.avi"\n'
    broken = write_captures(tmp_path / "broken", video, moving()[:1])
    (broken / "film.avi").write_bytes(b"no film")
    assert "does not decode" in refused(broken)
    small = write_captures(tmp_path / "small", VIDEO, moving())
    assert cv2.imwrite(str(small / "004.png"), np.zeros((50, 60), dtype=np.uint8))
    assert "frame 3 is 60x50 px" in refused(small)


@pytest.mark.thorough
def test_a_video_that_rests_is_enough(
    tmp_path: Path, base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = "mm_per_px_x = 0.06\nmm_per_px_y = 0.06\n[markers]\n[[markers.videos]]\n"
    manifest += 'frames = ["*.png"]\n'
    rest = moving()[0]
    folder = write_captures(tmp_path / "late", manifest, [*moving(12)[6:], *[rest] * 6])
    assert calibrate(folder, "--out", tmp_path / "p", "--base", base, "--json") == 0
    (video,) = json.loads(capsys.readouterr().out)["markers"]["videos"]
    assert (video["frames"], video["quiet_first"], video["quiet_frames"]) == (13, 6, 7)
    assert video["largest_px"] == pytest.approx(13.0 * np.sin(np.pi * 5 / 11), abs=0.1)
    assert video["seen_share"] == 1.0
    provenance = load_profile(tmp_path / "p")
    assert provenance.markers is not None
    spread = provenance.markers.provenance.spread["pitch_x_mm"]
    # A scale from the manifest is no better than a ruler.
    assert spread == pytest.approx(0.01 * PITCH_MM, rel=0.05)


def test_the_check_looks_where_measured_dots_are(tmp_path: Path) -> None:
    """Labels are places without load and the way from there to the labelled image."""
    manifest = '[markers]\nlabels_image = "000.png"\nlabels = "dots.csv"\n'
    rest = moving()[0]
    folder = write_captures(tmp_path / "press", manifest, [rest + (12.0, -5.0)])

    def codes(way: tuple[float, float]) -> set[str]:
        rows = [f"{u},{v},{way[0]},{way[1]}" for u, v in rest]
        (folder / "dots.csv").write_text("\n".join(["u_px,v_px,du_px,dv_px", *rows]))
        return {finding.code for finding in check_captures(load_capture_folder(folder)).findings}

    assert codes((12.0, -5.0)) == {"no_rest_frame"}
    assert codes((0.0, 0.0)) == {"no_rest_frame", "labels_off"}
