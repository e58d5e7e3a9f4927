# SPDX-License-Identifier: Apache-2.0
"""Images of a data set show the sensor's dots where its markers are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.camera.gel_camera import GelCamera
from taccel_lab.datasets.reading import Dataset
from taccel_lab.profile import CameraBlock, MarkersBlock, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.viewer.dataset_touches import read_touch
from tests.signals.find_dots import distances_px, find_dots
from tests.support.dotted_profiles import LIGHT, with_painted_dots
from tests.support.small_data_sets import ASSUMED, make, small_profile

WIDTH, HEIGHT, RADIUS_PX = 96, 72, 3.0


def dotted_profile(folder: Path) -> Path:
    """Colours that no press changes, on a pad with 4 x 3 dots."""
    profile = small_profile()
    view = profile.grid().resized(WIDTH, HEIGHT)
    pitch_mm = 18.0 * view.mm_per_px_x
    markers = MarkersBlock(
        rows=3, columns=4, pitch_x_mm=pitch_mm, pitch_y_mm=pitch_mm,
        radius_mm=RADIUS_PX * view.mm_per_px_x, provenance=ASSUMED,
    )  # fmt: skip
    for name in ("perturbation", "color", "background"):
        profile = profile.without(name)
    profile = profile.with_block(CameraBlock.from_grid(view, ASSUMED))
    places = view.pixel_from_gel(markers.grid().points_mm())
    save_profile(with_painted_dots(profile, places, RADIUS_PX).with_block(markers), folder)
    return folder


def test_dots_go_with_the_markers(tmp_path: Path) -> None:
    profile = dotted_profile(tmp_path / "profile")
    make(
        profile, tmp_path / "out", dataset={"episodes": 1},
        objects=[{"tool": "sphere:3"}],
        motions=[{"kind": "slip", "depth_mm": [0.3, 0.4], "shear_mm": [0.3, 0.4]}],
    )  # fmt: skip
    data = Dataset(tmp_path / "out")
    rgb = data.read("rgb", slice(None)).astype(float)
    markers = data.read("markers_px", slice(None))
    background = data.profile(0).background_rgb
    assert background is not None
    assert np.abs(rgb[0] - background).max() <= 1
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    moved = np.linalg.norm(markers[-1] - markers[0], axis=1)
    assert moved.max() > 0.7
    for step in (0, len(rgb) - 1):
        for u_px, v_px in markers[step]:
            near = np.hypot(u - u_px, v - v_px) < 2 * RADIUS_PX
            dark = (LIGHT - rgb[step, ..., 0])[near]
            middle = [(dark * u[near]).sum() / dark.sum(), (dark * v[near]).sum() / dark.sum()]
            assert np.hypot(*(np.array(middle) - [u_px, v_px])) < 0.25


@pytest.mark.parametrize(
    "sensor", ["gelsight_mini", pytest.param("gelsight_40", marks=pytest.mark.slow)]
)
def test_all_channels_of_a_predicted_picture_are_of_its_camera(sensor: str, tmp_path: Path) -> None:
    designed = catalogue_profile(sensor)
    assert designed.markers is not None
    radius_px = designed.markers.radius_mm / designed.camera.mm_per_px_x
    channels = ["rgb", "markers_px", "contact_mask", "depth_mm", "patch_forces_n"]
    make(
        sensor, tmp_path / "out",
        dataset={"episodes": 1, "x_mm": [3.0, 3.0], "y_mm": [2.0, 2.0]},
        objects=[{"tool": "sphere:4"}],
        motions=[{"kind": "press", "depth_mm": [0.7, 0.7]}],
        output={"channels": channels, "patches": [8, 6]},
    )  # fmt: skip
    data = Dataset(tmp_path / "out")
    rgb, markers, touched, patches = (
        data.read(name, slice(None))
        for name in ("rgb", "markers_px", "contact_mask", "patch_forces_n")
    )
    for step in (0, len(rgb) - 1):
        found = find_dots(rgb[step], radius_px)
        assert len(found) >= 0.9 * len(markers[step])
        assert distances_px(found, markers[step]).mean() < 0.3
    camera = GelCamera.of_record(data.about[0]["sensors"][0]["units"][0]["camera"])
    # A ball sunk into the face: the middle of what it touches, seen in perspective.
    middle = camera.pixel_from_gel(np.array([3.0, 2.0, -0.7]))
    v, u = np.nonzero(touched[-1])
    assert np.abs([u.mean() - middle[0], v.mean() - middle[1]]).max() < 1.0
    force = np.linalg.norm(patches[-1], axis=-1)
    row, column = np.mgrid[: force.shape[0], : force.shape[1]]
    size = np.array([camera.width_px, camera.height_px])
    place = np.array([(force * column).sum(), (force * row).sum()]) / force.sum()
    place = (place + 0.5) * size / force.shape[::-1] - 0.5
    assert np.abs(place - middle).max() < 1.5
    # What reads the folder knows where its pixels look.
    states = read_touch(data, 0)
    sunk = next(field.values[-1] for field in states.fields if field.label == "depth image")
    deepest = states.rest_mm[np.nanargmax(sunk)]
    assert np.hypot(*(deepest[:2] - [3.0, 2.0])) < 1.0
