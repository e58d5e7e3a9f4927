# SPDX-License-Identifier: Apache-2.0
"""The camera file is read by OpenCV, whose projection is that of the profile's camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.interop.export import export_profile
from taccel_lab.optics.camera_model import CameraModel
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
    export_profile(digit, "opencv", tmp_path / "out")
    found = read(tmp_path / "out" / "camera.yaml")
    points = POINTS_MM * [1, 1, 0] + [0, 0, 1]
    uv = points @ np.asarray(found["pixel_from_gel"]).T
    np.testing.assert_allclose(uv[:, :2], digit.grid().pixel_from_gel(POINTS_MM[:, :2]))
    assert (found["raw_width"], found["raw_height"]) == (480, 640)
    assert found["sensor"] == "digit"
