# SPDX-License-Identifier: Apache-2.0
"""The pixel grid that a measured scale gives a profile, and whether captures state another one."""

from __future__ import annotations

from collections.abc import Mapping

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.remarks import SCALE_DISAGREES
from taccel_lab.calibration.result import Estimate
from taccel_lab.profile import CameraBlock, SensorProfile
from taccel_lab.report.remark import Remark

STATED_SIGMAS, STATED_SHARE = 3.0, 0.02
"""A stated scale differs when it is off by this many standard deviations and by this share."""


def origin_px(profile: SensorProfile, size_px: tuple[int, int]) -> tuple[float, float] | None:
    """Where the profile has its gel frame's origin, if its image has this size."""
    camera = profile.camera
    if (camera.width_px, camera.height_px) != size_px:
        return None
    return camera.center_u_px, camera.center_v_px


def tactile_size(profile: SensorProfile, raw_px: tuple[int, int]) -> tuple[int, int] | None:
    """Size of the tactile image, where the profile says that it is a crop of pictures of ``raw_px``
    (``optics.crop_x`` and ``crop_y``); None where it is not."""
    camera, optics = profile.camera, profile.optics
    size = camera.width_px, camera.height_px
    if optics is None or (optics.raw_width_px, optics.raw_height_px) != raw_px:
        return None
    cropped = round(optics.crop_x * raw_px[0]), round(optics.crop_y * raw_px[1])
    return size if size == cropped and size != raw_px else None


def with_camera_block(profile: SensorProfile, block: CameraBlock) -> SensorProfile:
    """The profile with another pixel grid, without what belongs to the old one.

    Models from colour to normals and back, and to forces, were fitted at the old scale; a
    background of another size fits no more.
    """
    before = profile.camera
    if before.grid() == block.grid():
        return profile.with_block(block)
    stale = ["color", "normals", "force"]
    if (before.width_px, before.height_px) != (block.width_px, block.height_px):
        stale += ["background", "depth_response"]
    return profile.without(*stale).with_block(block)


def stated_scale_remarks(folder: CaptureFolder, measured: Mapping[str, Estimate]) -> list[Remark]:
    """Warnings where ``measured`` (mm/px by axis, ``x`` and ``y``) is not what captures state."""
    remarks = []
    for axis, found in measured.items():
        stated = None if folder.mm_per_px is None else folder.mm_per_px["xy".index(axis)]
        if stated is None:
            continue
        off = stated - found.value
        if abs(off) > max(STATED_SIGMAS * found.sigma, STATED_SHARE * stated):
            remarks.append(
                SCALE_DISAGREES(
                    scales=f"the captures state mm_per_px_{axis} = {stated:g}, measured is {found}"
                )
            )
    return remarks
