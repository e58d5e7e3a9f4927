# SPDX-License-Identifier: Apache-2.0
"""Real pictures: dots of five sensors, sensors without dots, a peer's displacements, a video."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.dots.marker_picture import find_markers
from taccel_lab.calibration.markers.track_figures import track_figures
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.errors import InputError
from taccel_lab.files.images import read_image
from tests.support.real_data import real_data

BOARD = "9dtact_official/shape_reconstruction/calibration/sensor_1/camera_calibration"


def real(name: str) -> np.ndarray:
    return read_image(real_data(name))


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


def test_part_of_a_real_video_is_followed() -> None:
    frames = [real(f"gsmini_markers_video/{n:04d}.png") for n in (0, *range(56, 90, 2))]
    tracks = track_markers(frames, find_markers(frames[0]))
    inner = ((tracks.rest_px > 25) & (tracks.rest_px < (295, 215))).all(axis=1)
    assert tracks.seen[:, inner].all()
    distance = tracks.distance_px()
    assert np.nanmax(distance) > 10.0
    assert np.nanmedian(distance[-1]) <= 0.7
