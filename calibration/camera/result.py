# SPDX-License-Identifier: Apache-2.0
"""A calibrated camera: lens, pose and scale with their evidence, the blocks that they give, and the
pixel grid that a measured scale gives a profile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.camera.board_on_gel import DISTORTED, OnGel, PoseInGel
from taccel_lab.calibration.camera.find_boards import Detections
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.camera.rectification import RectificationMaps, gel_maps, lens_maps
from taccel_lab.calibration.capture.folder import CaptureFolder, source_of
from taccel_lab.calibration.remarks import SCALE_DISAGREES
from taccel_lab.calibration.result import BlockResult, Estimate, calibrated
from taccel_lab.profile import CameraBlock, OpticsBlock, SensorProfile
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


_CALIBRATED = (
    "model", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion",
    "position_mm", "rotation",
)  # fmt: skip
"""Fields of an optics block that boards give."""


@dataclass(frozen=True, repr=False)
class CameraCalibration(BlockResult):
    """Lens, pose and scale, as far as the boards give them."""

    source: str
    intrinsics: Intrinsics | None
    on_gel: OnGel | None
    detections: Detections
    inputs: dict[str, str]
    provenance: dict[str, str]
    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        found: dict[str, Any] = {
            "views_found": len(self.detections.views),
            "views_refused": list(self.detections.refused),
        }
        if self.intrinsics is not None:
            found["intrinsics"] = _intrinsics_figures(self.intrinsics)
        if self.on_gel is not None:
            found["on_gel"] = _on_gel_figures(self.on_gel)
        return found

    def maps(self) -> RectificationMaps:
        """Maps to the gel's pixel grid, or, without a board on the gel, of the lens alone."""
        if self.on_gel is not None:
            return gel_maps(self.on_gel)
        assert self.intrinsics is not None
        return lens_maps(self.intrinsics)

    @property
    def rectification(self) -> RectificationMaps | None:
        """Maps to the gel's pixel grid; None without a board on the gel."""
        return None if self.on_gel is None else self.maps()

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the camera block (boards on the gel) and the optics block (views)."""
        if self.on_gel is not None:
            profile = with_camera_block(profile, camera_block(self))
        if self.intrinsics is not None:
            profile = profile.with_block(optics_block(self, profile))
        return profile


def camera_block(result: CameraCalibration) -> CameraBlock:
    """Pixel grid of the gel's face."""
    on_gel = result.on_gel
    assert on_gel is not None
    frame = on_gel.frame
    x_mm, y_mm = on_gel.points_in_gel_mm.T
    least, largest = on_gel.scale_range
    grid = on_gel.grid.width_px, on_gel.grid.height_px
    return CameraBlock.from_grid(
        on_gel.grid,
        calibrated(
            on_gel.remarks,
            method=f"board on the gel, {on_gel.fit.model.name}; mm/px are means over a pitch of "
            "the board to both sides of the origin; the origin is taken where the profile had it, "
            "else in the middle of the image",
            source=source_of(result.provenance, result.source),
            inputs=result.inputs,
            residuals={
                "board_rms_px": on_gel.fit.rms_px,
                "board_heldout_rms_px": on_gel.fit.heldout_px,
            },
            spread={
                "mm_per_px_x": frame.mm_per_px_x.sigma,
                "mm_per_px_y": frame.mm_per_px_y.sigma,
            },
            interval={
                "mm_per_px_x": frame.mm_per_px_x.interval95,
                "mm_per_px_y": frame.mm_per_px_y.interval95,
            },
            correlation={"mm_per_px_x*mm_per_px_y": frame.correlation},
            valid_region={
                "x_mm": (float(x_mm.min()), float(x_mm.max())),
                "y_mm": (float(y_mm.min()), float(y_mm.max())),
            },
        ),
        rectified=grid != on_gel.views[0].size_px or largest - least > DISTORTED,
    )


def optics_block(result: CameraCalibration, profile: SensorProfile) -> OpticsBlock:
    """The calibrated lens, with the pose from the board on the gel or else the designed one.

    ``profile`` already has the calibrated pixel grid where there is one.
    """
    found = result.intrinsics
    assert found is not None
    designed = profile.optics
    on_gel = result.on_gel
    spread = dict(
        zip(found.lens.parameter_names, (float(s) for s in found.chosen.fit.sigma), strict=True)
    )
    pose = None if on_gel is None else on_gel.pose
    residuals = found.chosen.errors_px()
    if pose is not None:
        position, rotation = pose.position_mm, pose.rotation
        where = "pose from the board on the gel" + (
            ", through window and gel" if pose.refracted else ", sight lines straight"
        )
        residuals["board_on_gel_heldout_rms_px"] = pose.fit.heldout_px
        spread |= dict(
            zip(("position_x_mm", "position_y_mm", "position_z_mm"), pose.position_sigma_mm,
                strict=True)
        )  # fmt: skip
    elif designed is not None:
        position, rotation = designed.position_mm, designed.rotation
        where = "pose as designed, no board lay on the gel"
    else:
        scale = np.mean([profile.camera.mm_per_px_x, profile.camera.mm_per_px_y])
        distance = float(np.mean(found.parameters[:2]) * scale)
        position, rotation = (0.0, 0.0, -distance), (0.0, 0.0, 0.0, 1.0)
        where = "pose assumed: straight above the gel at focal length times mm/px"
    camera = found.lens.camera(found.parameters, found.size_px, position, rotation)
    points = np.concatenate([view.uv_px for view in found.views])
    described: dict[str, Any] = {name: getattr(camera, name) for name in _CALIBRATED}
    described["provenance"] = calibrated(
        (*found.remarks, *(() if on_gel is None else on_gel.remarks)),
        method=f"{len(found.views)} views of a board, {found.lens.name} lens chosen among "
        f"{', '.join(score.lens.name for score in found.scores)} by {found.folds}-fold "
        f"held-out reprojection; {where}",
        source=source_of(result.provenance, result.source),
        inputs=result.inputs,
        residuals=residuals,
        spread=spread,
        correlation=_correlations(found),
        valid_region={
            "u_px": (float(points[:, 0].min()), float(points[:, 0].max())),
            "v_px": (float(points[:, 1].min()), float(points[:, 1].max())),
        },
    )
    # A board says nothing of apertures, crop and media: they stay as designed.
    return OpticsBlock(**described) if designed is None else designed.replace(**described)


def _correlations(found: Intrinsics) -> dict[str, float]:
    """Correlations above a half: estimates that move together."""
    names, sigma = found.lens.parameter_names, found.chosen.fit.sigma
    safe = np.maximum(sigma, 1e-300)
    matrix = np.clip(found.chosen.fit.covariance / np.outer(safe, safe), -1, 1)
    return {
        f"{names[i]}*{names[j]}": float(matrix[i, j])
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if abs(matrix[i, j]) > 0.5
    }


def _intrinsics_figures(found: Intrinsics) -> dict[str, Any]:
    fit, lens = found.chosen.fit, found.lens
    return {
        "model": lens.name,
        "image_px": list(found.size_px),
        "parameters": {
            name: {"value": float(value), "sigma": float(sigma)}
            for name, value, sigma in zip(
                lens.parameter_names, fit.parameters, fit.sigma, strict=True
            )
        },
        **found.chosen.errors_px(),
        "folds": found.folds,
        "views": len(found.views),
        "views_held_out": len(found.views) + len(found.outliers),
        "outlier_views": list(found.outliers),
        "coverage": found.coverage,
        "tilt_deg": list(found.tilt_deg),
        "models": {
            score.lens.name: {
                **score.errors_px(),
                "excess_mse_px2": score.excess,
                "excess_standard_error_px2": score.excess_error,
            }
            for score in found.scores
        },
    }


def _on_gel_figures(found: OnGel) -> dict[str, Any]:
    frame = found.frame
    figures: dict[str, Any] = {
        "model": found.fit.model.name,
        "image_px": list(found.views[0].size_px),
        "mm_per_px_x": {"value": frame.mm_per_px_x.value, "sigma": frame.mm_per_px_x.sigma},
        "mm_per_px_y": {"value": frame.mm_per_px_y.value, "sigma": frame.mm_per_px_y.sigma},
        "correlation": frame.correlation,
        "shear_deg": float(np.degrees(frame.shear)),
        "board_angle_deg": float(-np.degrees(frame.angle_rad)),
        "points": [len(view.index) for view in found.views],
        "points_on_board": [view.expected for view in found.views],
        "fit_rms_px": found.fit.rms_px,
        "heldout_rms_px": found.fit.heldout_px,
        "scale_range": list(found.scale_range),
        "models": {
            fit.model.name: {"fit_rms_px": fit.rms_px, "heldout_rms_px": fit.heldout_px}
            for fit in found.fits
        },
    }
    if found.pose is not None:
        figures["pose"] = _pose_figures(found.pose)
        figures["poses"] = [_pose_figures(pose) for pose in found.poses]
    return figures


def _pose_figures(pose: PoseInGel) -> dict[str, Any]:
    return {
        "position_mm": list(pose.position_mm),
        "position_sigma_mm": list(pose.position_sigma_mm),
        "rotation_xyzw": list(pose.rotation),
        "tilt_deg": pose.tilt_deg,
        "refracted": pose.refracted,
        "heldout_rms_px": pose.fit.heldout_px,
    }
