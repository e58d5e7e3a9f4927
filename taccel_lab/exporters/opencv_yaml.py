# SPDX-License-Identifier: Apache-2.0
"""The camera as OpenCV's FileStorage YAML, with the maps between image and gel.

Keys as in OpenCV's calibration samples: ``camera_matrix``, ``distortion_coefficients``,
``image_width``; R and t take points of the gel frame [mm] into the camera's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.camera.gel_camera import rectified_matrix
from taccel_lab.exporters.record import ExportRecord, required
from taccel_lab.profile import SensorProfile

MEASURED = ("calibrated", "measured")
"""Kinds of blocks that say something about the unit at hand."""


def export_opencv(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write ``camera.yaml``; needs the block optics."""
    import cv2

    block = required(profile, "optics", "an OpenCV camera file", profile.optics)
    camera, grid = block.camera(), profile.grid()
    camera_from_gel = camera.gel_from_camera().T
    translation = -camera_from_gel @ np.array(camera.position_mm)
    matrix = np.array(
        [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
    )
    count = 4 if camera.model == "fisheye" else max(5, len(camera.distortion))
    distortion = np.zeros(count)
    distortion[: len(camera.distortion)] = camera.distortion
    pixel_from_gel = np.array(
        [
            [1 / grid.mm_per_px_x, 0.0, grid.center_u_px],
            [0.0, 1 / grid.mm_per_px_y, grid.center_v_px],
            [0.0, 0.0, 1.0],
        ]
    )
    rectified = rectified_matrix(block, profile)
    # In memory: OpenCV's own writer ends the process at a path that is not UTF-8.
    mode = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage("camera.yaml", mode)
    try:
        storage.write("sensor", profile.sensor.name)
        storage.write("model", camera.model)
        storage.write("image_width", camera.width_px)
        storage.write("image_height", camera.height_px)
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", distortion[None])
        storage.write("R", camera_from_gel)
        storage.write("t", translation[:, None])
        storage.write("rvec", cv2.Rodrigues(camera_from_gel)[0])
        storage.write("raw_width", block.raw_width_px)
        storage.write("raw_height", block.raw_height_px)
        storage.write("crop_x", block.crop_x)
        storage.write("crop_y", block.crop_y)
        storage.write("gel_refractive_index", block.gel_refractive_index)
        storage.write("tactile_width", grid.width_px)
        storage.write("tactile_height", grid.height_px)
        storage.write("pixel_from_gel", pixel_from_gel)
        storage.write("rectification_R", camera.gel_from_camera())
        storage.write("rectification_P", rectified)
        storage.write("mm_per_px", np.array([[grid.mm_per_px_x, grid.mm_per_px_y]]))
        (folder / "camera.yaml").write_text(storage.releaseAndGetString(), encoding="utf-8")
    finally:
        storage.release()
    record = ExportRecord(
        carries={
            "optics": "intrinsics, distortion, pose, crop of the camera's own pictures",
            "camera": "the affine map from gel xy [mm] to pixels of the tactile image; matrices "
            "that rectify to it",
        },
        notes=[
            "R and t: x_camera = R x_gel + t [mm]; the gel frame has x right, y down in the image "
            "and z out of the gel",
            "pixel centres are whole numbers; the intrinsics are in pixels of image_width x "
            "image_height",
            "rectification_R and rectification_P, with tactile_width and tactile_height, make the "
            "maps of cv2.initUndistortRectifyMap (or cv2.fisheye's): to a view straight onto the "
            "gel in which pixel_from_gel holds everywhere, refraction to first order",
            "project points with refraction in mind: gel and window lie between lens and gel face; "
            "pixel_from_gel has it measured in",
            "fisheye: pass the four coefficients to cv2.fisheye"
            if camera.model == "fisheye"
            else "distortion_coefficients in the order k1 k2 p1 p2 k3 [k4 k5 k6]",
        ],
    )
    for what, kind in (
        (
            "mm_per_px, and with it pixel_from_gel and rectification_P",
            profile.camera.provenance.kind,
        ),
        ("camera_matrix, R and t", block.provenance.kind),
    ):
        if kind not in MEASURED:
            record.notes.append(f"{what}: {kind}, not measured on this unit")
    if profile.window is not None:
        record.left_out["window"] = "OpenCV's models know no refraction"
    if camera.focus_mm or camera.aperture_mm:
        record.left_out["optics.focus"] = "OpenCV's models know no depth of field"
    return record
