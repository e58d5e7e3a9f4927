# SPDX-License-Identifier: Apache-2.0
"""The camera and optics blocks that a calibration of the camera gives, with their evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.result import judge
from taccel_lab.profile import CameraBlock, OpticsBlock, Provenance, SensorProfile

if TYPE_CHECKING:
    from taccel_lab.calibration.camera.fit import CameraCalibration


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

    Models from colour to normals and back were fitted at the old scale; a background of another
    size fits no more.
    """
    before = profile.camera
    if before.grid() == block.grid():
        return profile.with_block(block)
    stale = ["color", "normals"]
    if (before.width_px, before.height_px) != (block.width_px, block.height_px):
        stale += ["background", "depth_response"]
    return profile.without(*stale).with_block(block)


def camera_block(result: CameraCalibration) -> CameraBlock:
    """Pixel grid of the gel's face."""
    on_gel = result.on_gel
    assert on_gel is not None
    frame = on_gel.frame
    x_mm, y_mm = on_gel.points_in_gel_mm.T
    return CameraBlock.from_grid(
        on_gel.grid,
        Provenance(
            kind="calibrated",
            method=(
                f"board on the gel, {on_gel.fit.model.name}; mm/px are means over a pitch of the "
                "board to both sides of the origin; the origin is taken where the profile had it, "
                "else in the middle of the image"
            ),
            source=result.provenance.get("source", result.source),
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
            verdict=judge(on_gel.remarks).value,
            remarks=tuple(remark.message for remark in on_gel.remarks),
        ),
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
    residuals = {
        "fit_rms_px": found.chosen.fit.rms_px,
        "heldout_rms_px": found.chosen.heldout_all_px,
        "heldout_robust_rms_px": found.chosen.heldout_robust_px,
        "heldout_half_board_rms_px": found.chosen.heldout_half_px,
    }
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
    remarks = [*found.remarks, *([] if on_gel is None else on_gel.remarks)]
    values = {} if designed is None else _kept(designed)
    points = np.concatenate([view.uv_px for view in found.views])
    return OpticsBlock(
        model=camera.model,
        width_px=camera.width_px,
        height_px=camera.height_px,
        fx_px=camera.fx_px,
        fy_px=camera.fy_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
        distortion=camera.distortion,
        position_mm=camera.position_mm,
        rotation=camera.rotation,
        **values,
        provenance=Provenance(
            kind="calibrated",
            method=(
                f"{len(found.views)} views of a board, {found.lens.name} lens chosen among "
                f"{', '.join(score.lens.name for score in found.scores)} by {found.folds}-fold "
                f"held-out reprojection; {where}"
            ),
            source=result.provenance.get("source", result.source),
            inputs=result.inputs,
            residuals=residuals,
            spread=spread,
            correlation=_correlations(found),
            valid_region={
                "u_px": (float(points[:, 0].min()), float(points[:, 0].max())),
                "v_px": (float(points[:, 1].min()), float(points[:, 1].max())),
            },
            verdict=judge(remarks).value,
            remarks=tuple(remark.message for remark in remarks),
        ),
    )


def _kept(designed: OpticsBlock) -> dict:
    """What a board says nothing of."""
    names = (
        "focus_mm",
        "aperture_mm",
        "falloff",
        "raw_width_px",
        "raw_height_px",
        "crop_x",
        "crop_y",
        "gel_refractive_index",
        "gel_scattering_per_mm",
        "ambient_rgb",
    )
    return {name: getattr(designed, name) for name in names}


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
