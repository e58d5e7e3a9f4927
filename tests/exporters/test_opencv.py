# SPDX-License-Identifier: Apache-2.0
"""The camera file is read by OpenCV, whose projection is that of the profile's camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.camera.gel_camera import CameraModel
from taccel_lab.exporters.export import export_profile
from taccel_lab.profile import SensorProfile

POINTS_MM = np.array([[0.0, 0, 0], [4, -3, 0], [-5, 6, -1], [2, 2, -0.5]])


def read(path: Path) -> dict[str, np.ndarray | str | float]:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    values: dict[str, np.ndarray | str | float] = {}
    for key in storage.root().keys():
        node = storage.getNode(key)
        values[key] = (
            node.string() if node.isString() else node.real() if not node.isMap() else node.mat()
        )
    storage.release()
    return values


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_opencv_projects_as_the_profile(model: str, digit: SensorProfile, tmp_path: Path) -> None:
    assert digit.optics is not None
    changes: dict[str, object] = {
        "rotation": tuple(Rotation.from_rotvec([0.02, -0.05, 0.3]).as_quat().tolist()),
        "position_mm": (0.5, -1.0, -20.0),
        "fy_px": 0.8 * digit.optics.fy_px,
    }
    if model == "fisheye":
        changes |= {"model": "fisheye", "distortion": (-0.05, 0.01, 0.002, -0.001)}
    profile = digit.with_block(digit.optics.replace(**changes))
    assert profile.optics is not None
    export_profile(profile, "opencv", tmp_path / "out")
    found = read(tmp_path / "out" / "camera.yaml")
    assert found["model"] == model
    assert (found["image_width"], found["image_height"]) == (240, 320)
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    points, rvec = POINTS_MM[:, None], np.asarray(found["rvec"])
    t, matrix = np.asarray(found["t"]), np.asarray(found["camera_matrix"])
    distortion = np.asarray(found["distortion_coefficients"])
    image, _ = project(points, rvec, t, matrix, distortion)
    wanted = CameraModel(profile.optics.camera()).project(POINTS_MM)
    np.testing.assert_allclose(np.asarray(image)[:, 0], wanted, atol=1e-6)
    np.testing.assert_allclose(cv2.Rodrigues(rvec)[0], found["R"], atol=1e-12)


def test_the_map_from_gel_to_pixels(digit: SensorProfile, tmp_path: Path) -> None:
    assert digit.optics is not None
    taller = digit.camera.replace(mm_per_px_y=1.2 * digit.camera.mm_per_px_x)
    profile = digit.with_block(taller).with_block(digit.optics.replace(crop_x=0.9, crop_y=0.8))
    export_profile(profile, "opencv", tmp_path / "out")
    found = read(tmp_path / "out" / "camera.yaml")
    points = POINTS_MM * [1, 1, 0] + [0, 0, 1]
    uv = points @ np.asarray(found["pixel_from_gel"]).T
    np.testing.assert_allclose(uv[:, :2], profile.grid().pixel_from_gel(POINTS_MM[:, :2]))
    scale = np.asarray(found["mm_per_px"])
    np.testing.assert_allclose(scale, [[taller.mm_per_px_x, taller.mm_per_px_y]])
    assert (found["raw_width"], found["raw_height"]) == (480, 640)
    assert (found["crop_x"], found["crop_y"]) == (0.9, 0.8)
    assert found["sensor"] == "digit"


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
@pytest.mark.parametrize("size", [(240, 320), (200, 260)])
def test_rectified_pixels_are_those_of_the_grid(
    model: str, size: tuple[int, int], digit: SensorProfile, tmp_path: Path
) -> None:
    """Without refraction exactly: a lens in air, tilted, whose image is larger than the grid's."""
    assert digit.optics is not None
    rotation = Rotation.from_rotvec([0.05, -0.03, 0.1])
    values: dict[str, object] = {
        "rotation": tuple(rotation.as_quat().tolist()),
        "gel_refractive_index": 1.0,
        "distortion": (-0.05, 0.01, 0.002, -0.001),
        "model": model,
    }
    camera = digit.camera.replace(
        width_px=size[0],
        height_px=size[1],
        center_u_px=90.0,
        mm_per_px_y=1.15 * digit.camera.mm_per_px_x,
    )
    profile = digit.without("window").with_block(camera)
    # The distance at which the focal length gives the grid's scale along the optical axis.
    focal = digit.optics.fx_px
    z_mm = focal * camera.mm_per_px_x * rotation.as_matrix()[2, 2]
    profile = profile.with_block(
        digit.optics.replace(position_mm=(0.4, 0.7, -z_mm), fy_px=focal / 1.15, **values)
    )
    export_profile(profile, "opencv", tmp_path / "out")
    found = read(tmp_path / "out" / "camera.yaml")
    make = (
        cv2.fisheye.initUndistortRectifyMap if model == "fisheye" else cv2.initUndistortRectifyMap
    )
    maps = make(
        *(
            np.asarray(found[key])
            for key in (
                "camera_matrix",
                "distortion_coefficients",
                "rectification_R",
                "rectification_P",
            )
        ),
        size,
        cv2.CV_32FC1,
    )
    assert profile.optics is not None
    uv = np.array([[20, 30], [150, 200], [100, 60]])
    gel = np.concatenate([profile.grid().gel_from_pixel(uv), np.zeros((3, 1))], axis=1)
    wanted = CameraModel(profile.optics.camera()).project(gel)
    source = np.stack([part[uv[:, 1], uv[:, 0]] for part in maps], axis=-1)
    np.testing.assert_allclose(source, wanted, atol=1e-3)


def test_what_was_not_measured_is_said(digit: SensorProfile, tmp_path: Path) -> None:
    document = export_profile(digit, "opencv", tmp_path / "designed")
    said = [note for note in document["notes"] if "not measured on this unit" in note]
    assert len(said) == 2 and said[0].startswith("mm_per_px")
    measured = digit.camera.provenance.replace(kind="measured")
    profile = digit.with_block(digit.camera.replace(provenance=measured))
    again = export_profile(profile, "opencv", tmp_path / "measured")
    assert [n for n in again["notes"] if "not measured on this unit" in n] == said[1:]
