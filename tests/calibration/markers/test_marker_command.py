# SPDX-License-Identifier: Apache-2.0
"""Markers of capture folders, from captures to a profile."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.calibration.markers.tracks import track_figures
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import MarkersBlock, load_profile, save_profile
from taccel_lab.reading.dots.marker_picture import find_markers
from tests.calibration.drawn.dots import HEIGHT, WIDTH, grid_points, nearest, picture
from tests.support.capture_sets import edit_manifest, write_image
from tests.support.commands import done, refusal
from tests.support.real_data import real_data
from tests.support.synthetic_presses import tiny_profile

BOARD = "9dtact_official/shape_reconstruction/calibration/sensor_1/camera_calibration"


def real(name: str) -> np.ndarray:
    return read_image(real_data(name))


@pytest.mark.thorough(cases=("gelslim", "difftactile", "9dtact"))
@pytest.mark.parametrize(
    ("name", "rows", "columns", "least"),
    [
        pytest.param("gsmini_markers_video/0000.png", 8, 10, 78, id="mini"),
        pytest.param("fots_calib/marker_calib/data/0.png", 9, 11, 97, id="fots"),
        pytest.param(
            "gsmini_feats_calib/src/feats/homography/cuboid_10-2-284.png", 7, 9, 63, id="feats"
        ),
        pytest.param(
            "gelslim_mcubelab/reconstruction/images/reconstruct_0.jpg", 14, 19, 250, id="gelslim"
        ),
        pytest.param("backgrounds_misc/difftactile_init.png", 14, 10, 134, id="difftactile"),
        pytest.param(f"{BOARD}/sample.png", 7, 9, 63, id="9dtact"),
    ],
)
def test_dots_of_real_sensors_are_numbered(name: str, rows: int, columns: int, least: int) -> None:
    lattice = find_markers(real(name)).lattice
    assert (lattice.rows, lattice.columns) == (rows, columns)
    assert lattice.numbered.sum() >= least
    # Bent by the lens: the board by most, a 7th of the corner's distance from the middle.
    assert lattice.irregularity < 0.08


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
    """FOTS's 99 dots in whole pixels, which are cut and not rounded."""
    table = np.loadtxt(real_data("fots_calib/marker_calib/data/0.csv"), delimiter=",", skiprows=1)
    found = find_markers(real("fots_calib/marker_calib/data/0.png")).dots
    own, error = nearest(found.uv_px[found.whole], table[:, :2] + 0.5 + table[:, 2:])
    assert len(set(own)) == len(own) >= 85
    assert np.median(np.linalg.norm(error, axis=1)) <= 0.6


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param((0, *range(56, 90, 2)), marks=pytest.mark.thorough, id="part"),
        pytest.param(tuple(range(121)), marks=pytest.mark.slow, id="whole"),
    ],
)
def test_a_real_video_is_followed_to_the_end(numbers: tuple[int, ...]) -> None:
    frames = [real(f"gsmini_markers_video/{n:04d}.png") for n in numbers]
    tracks = track_markers(frames, find_markers(frames[0]))
    # Dots that stay in the picture are seen all the way.
    inner = ((tracks.rest_px > 25) & (tracks.rest_px < (295, 215))).all(axis=1)
    assert tracks.seen[:, inner].all()
    distance = tracks.distance_px()
    assert np.nanmax(distance) > 10.0
    assert np.nanmedian(distance[numbers.index(88)]) <= 0.7
    if len(numbers) == 121:
        still = tracks.uv_px[:54, tracks.seen[:54].all(axis=0)]
        assert np.median(still.std(axis=0, ddof=1)) <= 0.02
        figures = track_figures("video", tracks)
        assert figures.return_frame == 88
        assert figures.return_median_px is not None and figures.return_median_px <= 0.6


PITCH_MM, SCALE = 1.8, 0.06
RESTS = '[markers]\nrest = "000.png"\n'
SCALED = "mm_per_px_x = 0.06\nmm_per_px_y = 0.06\n"
VIDEO = f"""{SCALED}{RESTS}[[markers.videos]]
frames = ["00[1-7].png"]
fps = 20.0
motion = "shear"
"""
STILL = grid_points(pitch=(30.0, 30.0), turn_rad=0.02)


def swayed(shares: np.ndarray) -> list[np.ndarray]:
    return [STILL + (12.0 * share, -5.0 * share) for share in shares]


MOVING = [STILL, *swayed(np.sin(np.pi * np.arange(7) / 6))]


def write_captures(folder: Path, manifest: str, centres: list[np.ndarray]) -> Path:
    folder.mkdir()
    for number, points in enumerate(centres):
        write_image(folder / f"{number:03d}.png", rgb(picture(points, noise=1.0, seed=number)))
    text = f'schema_version = 2\nsensor = "gelsight"\n{manifest}'
    (folder / "captures.toml").write_text(text, encoding="utf-8")
    return folder


def rgb(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None], 3, axis=2)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    save_profile(tiny_profile(PixelGrid(WIDTH, HEIGHT, 0.07, 0.07)), tmp_path / "base")
    return tmp_path / "base"


class Found(NamedTuple):
    block: MarkersBlock
    figures: dict[str, Any]
    told: str


@pytest.fixture
def calibrated(base: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Found]:
    """Calibrates the markers of a capture folder into a profile beside it."""

    def run(folder: Path, *words: object) -> Found:
        out = folder.with_name(f"{folder.name}_profile")
        ended = done(
            capsys, "calibrate", "markers", folder, "--out", out, "--base", base, "--json", *words
        )
        assert ended.code == 0, ended.err
        block = load_profile(out).markers
        assert block is not None
        return Found(block, json.loads(ended.out)["markers"], " ".join(ended.err.split()))

    return run


@pytest.mark.thorough
def test_captures_become_a_block_a_report_and_tracks(tmp_path: Path, calibrated) -> None:
    folder = write_captures(tmp_path / "captures", VIDEO, MOVING)
    block, figures, _ = calibrated(folder, "--tracks", tmp_path / "tracks.npz")
    assert (block.rows, block.columns) == (7, 9)
    assert block.pitch_x_mm == pytest.approx(PITCH_MM, abs=1e-3)
    assert block.rotation_deg == pytest.approx(np.degrees(0.02), abs=0.02)
    assert block.radius_mm == pytest.approx(5.0 * SCALE, rel=0.03)
    assert block.offset_mm[0] == pytest.approx((159.3 - 159.5) * SCALE, abs=2e-3)
    provenance = block.provenance
    assert (provenance.kind, provenance.verdict) == ("calibrated", "good")
    assert set(provenance.inputs) == {"000.png", "captures/001.png", "captures.toml"}
    assert abs(block.pitch_x_mm - PITCH_MM) < 4 * provenance.spread["pitch_x_mm"]
    assert figures["videos"][0]["seen_share"] == 1.0
    assert figures["videos"][0]["largest_px"] == pytest.approx(13.0, abs=0.1)
    page = (tmp_path / "captures_profile_report" / "report.html").read_text(encoding="utf-8")
    assert "video0_tracks" in page or "Paths of the dots" in page
    arrays = np.load(tmp_path / "tracks.npz")
    assert arrays["video0_uv_px"].shape == (7, 63, 2)
    assert str(arrays["video0_name"]) == "captures/001.png"
    moved = [[12.0 * SCALE, -5.0 * SCALE]] * 63
    np.testing.assert_allclose(arrays["video0_displacement_mm"][3], moved, atol=0.01)
    np.testing.assert_allclose(arrays["video0_time_s"], np.arange(7) / 20.0)
    calibrated(folder, "--tracks", tmp_path / "tracks.csv")
    with (tmp_path / "tracks.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 7 * 63 and rows[-1]["status"] == "seen"
    assert float(rows[3 * 63]["dx_mm"]) == pytest.approx(12.0 * SCALE, abs=0.01)


def test_the_radius_is_known_better_than_the_dots_differ(tmp_path: Path, calibrated) -> None:
    """By the deviation of a median of 63 and the scale's of 1 %."""
    folder = write_captures(tmp_path / "captures", SCALED + RESTS, [])
    radii = np.random.default_rng(0).normal(5.0, 0.4, 63)
    write_image(folder / "000.png", rgb(picture(STILL, radii, noise=1.0)))
    sigma = calibrated(folder).figures["estimates"]["radius_mm"]["sigma"]
    expected = np.hypot(1.2533 * 0.4 * SCALE / np.sqrt(63), 0.01 * 5.0 * SCALE)
    assert sigma == pytest.approx(expected, rel=0.3)


def test_a_stated_pitch_gives_the_scale_and_missing_dots_are_kept(tmp_path, calibrated) -> None:
    left = np.delete(STILL, [2 * 9 + 3, 4 * 9 + 7], axis=0)
    folder = write_captures(tmp_path / "captures", f"{RESTS}pitch_x_mm = 1.8\n", [left])
    block = calibrated(folder).block
    assert block.pitch_x_mm == pytest.approx(1.8, abs=1e-6)
    assert block.pitch_y_mm == pytest.approx(1.8, abs=2e-3)
    assert block.missing == ((2, 3), (4, 7))
    assert len(block.grid().points_mm()) == 61


@pytest.mark.thorough
def test_an_assumed_scale_and_a_contradiction_are_told(tmp_path: Path, calibrated) -> None:
    folder = write_captures(tmp_path / "captures", RESTS, [STILL])
    assert "nobody measured" in calibrated(folder).told
    scale = "mm_per_px_x = 0.05\nmm_per_px_y = 0.05\n"
    edit_manifest(folder, RESTS, f"{scale}{RESTS}pitch_x_mm = 1.8\n")
    assert "+20.0 and +20.0 %" in calibrated(folder).told


@pytest.mark.thorough
def test_what_cannot_be_used_is_refused(tmp_path: Path, base: Path, capsys) -> None:
    film = '[[markers.videos]]\nfile = "film.avi"\n'
    for name, manifest, centres, said in (
        ("nothing", RESTS, [np.empty((0, 2))], "no dots found"),
        ("tracks.txt", RESTS, [STILL], ".npz, .csv"),
        ("bare", "", [STILL], "no background"),
        ("film", RESTS + film, [STILL], "does not decode"),
        ("small", VIDEO, MOVING, "frame 3 is 60x50 px"),
    ):
        folder, out = write_captures(tmp_path / name, manifest, centres), tmp_path / "none"
        (folder / "film.avi").write_bytes(b"no film")
        if name == "small":
            write_image(folder / "004.png", np.zeros((50, 60, 3), np.uint8))
        more = ("--tracks", tmp_path / "out.txt") if name == "tracks.txt" else ()
        words = ("calibrate", "markers", folder, "--out", out, "--base", base, *more)
        assert said in refusal(capsys, *words)
        assert not out.exists()


@pytest.mark.thorough
def test_a_video_that_rests_is_enough(tmp_path: Path, calibrated) -> None:
    manifest = f'{SCALED}[markers]\n[[markers.videos]]\nframes = ["*.png"]\n'
    moving = swayed(np.sin(np.pi * np.arange(5, 12) / 11))
    block, figures, _ = calibrated(
        write_captures(tmp_path / "late", manifest, [*moving, *[STILL] * 6])
    )
    (video,) = figures["videos"]
    assert (video["frames"], video["quiet_first"], video["quiet_frames"]) == (13, 6, 7)
    assert video["largest_px"] == pytest.approx(13.0 * np.sin(np.pi * 5 / 11), abs=0.1)
    assert video["seen_share"] == 1.0
    # A scale from the manifest is no better than a ruler.
    spread = block.provenance.spread["pitch_x_mm"]
    assert spread == pytest.approx(0.01 * PITCH_MM, rel=0.05)


def test_the_check_looks_where_measured_dots_are(tmp_path: Path) -> None:
    """Labels are places without load and the way from there to the labelled image."""
    manifest = '[markers]\nlabels_image = "000.png"\nlabels = "dots.csv"\n'
    folder = write_captures(tmp_path / "press", manifest, swayed(np.ones(1)))
    for way, found in (
        ((12.0, -5.0), {"no_rest_frame"}),
        ((0, 0), {"no_rest_frame", "labels_off"}),
    ):
        rows = [f"{u},{v},{way[0]},{way[1]}" for u, v in STILL]
        (folder / "dots.csv").write_text("\n".join(["u_px,v_px,du_px,dv_px", *rows]))
        check = check_captures(load_capture_folder(folder))
        assert {finding.code for finding in check.findings} == found
