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
from tests.exporters.consumers import opencv_values

POINTS_MM = np.array([[0.0, 0, 0], [4, -3, 0], [-5, 6, -1], [2, 2, -0.5]])


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
@pytest.mark.parametrize("size", [(240, 320), (200, 260)])
def test_rectified_pixels_are_those_of_the_grid(
    model: str, size: tuple[int, int], digit: SensorProfile, tmp_path: Path
) -> None:
    """Without refraction exactly: a lens in air, tilted, whose image is larger than the grid's."""
    assert digit.optics is not None
    rotation = Rotation.from_rotvec([0.05, -0.03, 0.1])
    camera = digit.camera.replace(
        width_px=size[0], height_px=size[1], center_u_px=90.0,
        mm_per_px_y=1.15 * digit.camera.mm_per_px_x,
    )  # fmt: skip
    # The distance at which the focal length gives the grid's scale along the optical axis.
    focal = digit.optics.fx_px
    z_mm = focal * camera.mm_per_px_x * rotation.as_matrix()[2, 2]
    optics = digit.optics.replace(
        model=model, rotation=tuple(rotation.as_quat().tolist()), gel_refractive_index=1.0,
        distortion=(-0.05, 0.01, 0.002, -0.001), position_mm=(0.4, 0.7, -z_mm), fy_px=focal / 1.15,
    )  # fmt: skip
    profile = digit.without("window").with_block(camera).with_block(optics)
    export_profile(profile, "opencv", tmp_path / "out")
    found = opencv_values(tmp_path / "out" / "camera.yaml")
    make = (
        cv2.fisheye.initUndistortRectifyMap if model == "fisheye" else cv2.initUndistortRectifyMap
    )
    maps = make(
        found["camera_matrix"], found["distortion_coefficients"], found["rectification_R"],
        found["rectification_P"], size, cv2.CV_32FC1,
    )  # fmt: skip
    uv = np.array([[20, 30], [150, 200], [100, 60]])
    gel = np.concatenate([profile.grid().gel_from_pixel(uv), np.zeros((3, 1))], axis=1)
    wanted = CameraModel(optics.camera()).project(gel)
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
