# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab's visuo-tactile sensor (TacSL): data folder of its GelSight renderer, configuration.

``GelSightRenderCfg`` names a folder with ``bg.jpg``, ``polycalib.npz`` and ``real_bg.npy``; the
renderer looks up the gradient of the height, grad_r is red, and it measures in one scale for both
axes (isaaclab_contrib/sensors/tacsl_sensor of Isaac Lab 2.3 and later).
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.exporters.frames import LINK_FROM_GEL, effective_camera, m_from_mm
from taccel_lab.exporters.record import ExportRecord, required
from taccel_lab.exporters.taxim_distil import distil_table
from taccel_lab.files.atomic_file import eight_bit, write_by, write_image, write_json
from taccel_lab.geometry import Region
from taccel_lab.profile import SensorProfile

BINS = 120
_MARGIN_M = 0.003
_ARRAY = (20, 25)
"""Tactile points where the profile has no markers: those of TacSL's GelSight R1.5."""
_APERTURE = 20.955
"""Isaac Sim's default horizontal aperture [its unit]; only the ratio to the focal length counts."""


def export_isaac_lab(profile: SensorProfile, folder: Path) -> ExportRecord:
    """Write the folder; needs the blocks color and background."""
    import cv2

    required(profile, "color", "an Isaac Lab folder", profile.color)
    background = required(profile, "background", "an Isaac Lab folder", profile.background_rgb)
    made = distil_table(profile, BINS, "gradient")
    data = folder / _data_name(profile)
    data.mkdir()
    write_by(data / "polycalib.npz", partial(np.savez, **made.table.arrays("rgb")))
    levels = np.asarray(background, dtype=np.float32)
    write_by(data / "real_bg.npy", lambda file: np.save(file, levels))
    write_image(
        data / "bg.jpg",
        background,
        (cv2.IMWRITE_JPEG_QUALITY, 100, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111),
    )
    stored = np.asarray(cv2.imdecode(np.fromfile(data / "bg.jpg", np.uint8), cv2.IMREAD_COLOR))
    configuration = _configuration(profile, made.mm_per_px)
    write_json(folder / "sensor_cfg.json", configuration)
    (folder / "sensor_cfg.py").write_text(_python(configuration), encoding="utf-8")

    record = ExportRecord(
        carries={
            "color": f"as a table of {BINS} x {BINS} bins, distilled from the network",
            "background": "as bg.jpg (lossy) and real_bg.npy (as it is)",
            "camera": "image size and scale",
            "material": "friction; stiffnesses of the penalty model, worked out from the modulus",
        },
        approximations={
            **made.errors,
            "background_jpeg_max_levels": float(
                np.abs(stored[..., ::-1].astype(int) - eight_bit(background)).max()
            ),
            "scale_difference": abs(profile.camera.mm_per_px_x / profile.camera.mm_per_px_y - 1),
        },
        notes=[
            "the renderer's height map is the depth at rest minus the present depth [m], positive "
            "in a dent; row and column are those of the profile's image",
            "normal_contact_stiffness and tangential_stiffness are E A / t and G A / t of the gel "
            "column under one tactile point, without the stiffening of a bonded layer",
            "camera offset: ROS convention, relative to a link whose x points out of the gel, y "
            "left and z up in the image, with its origin at the gel's apex",
            "the camera sees without refraction: it stands at the apparent distance",
        ],
    )
    record.leave_out_missing(profile, "optics", "markers")
    record.left_out["color.displacement"] = (
        "the table knows only normals; it holds the mean over the displacements of ball presses"
    )
    record.left_out["elastomer"] = (
        "USD assets are not written; the surface is in the urdf export, which Isaac Sim imports"
    )
    record.dots_stand_still(profile)
    return record


def _data_name(profile: SensorProfile) -> str:
    kept = "".join(c if c.isalnum() else "_" for c in profile.sensor.name)
    return f"{kept}_data"


def _configuration(profile: SensorProfile, mm_per_px: float) -> dict[str, Any]:
    grid, material = profile.grid(), profile.material
    rows, columns = (
        _ARRAY if profile.markers is None else (profile.markers.rows, profile.markers.columns)
    )
    nodes = profile.mesh.nodes_m[profile.mesh.region_nodes(Region.CONTACT)]
    width, length = np.ptp(nodes[:, 0]), np.ptp(nodes[:, 1])
    column = width * length / (rows * columns) / m_from_mm(profile.gel.thickness_mm)
    shear = material.young_modulus_pa / (2 * (1 + material.poisson_ratio))
    camera = effective_camera(profile)
    return {
        "render_cfg": {
            "sensor_data_dir_name": _data_name(profile),
            "background_path": "bg.jpg",
            "calib_path": "polycalib.npz",
            "real_background": "real_bg.npy",
            "image_height": grid.height_px,
            "image_width": grid.width_px,
            "num_bins": BINS,
            "mm_per_pixel": mm_per_px,
        },
        "sensor_cfg": {
            "tactile_array_size": [rows, columns],
            "tactile_margin": _MARGIN_M,
            "normal_contact_stiffness": float(material.young_modulus_pa * column),
            "tangential_stiffness": float(shear * column),
            "friction_coefficient": material.friction_coefficient,
        },
        "camera_cfg": None
        if camera is None
        else {
            "height": camera.height_px,
            "width": camera.width_px,
            "focal_length": _APERTURE * camera.fx_px / camera.width_px,
            "horizontal_aperture": _APERTURE,
            "clipping_range": [1e-4, 0.1],
            "offset_pos_m": list(LINK_FROM_GEL @ m_from_mm(camera.position_mm)),
            "offset_quat_xyzw": _quaternion(LINK_FROM_GEL @ camera.gel_from_camera),
            "offset_convention": "ros",
            "distance_m": camera.distance_m,
        },
    }


def _quaternion(rotation: np.ndarray) -> list[float]:
    from scipy.spatial.transform import Rotation

    return [float(value) for value in Rotation.from_matrix(rotation).as_quat()]


def _python(configuration: dict[str, Any]) -> str:
    render, sensor = configuration["render_cfg"], configuration["sensor_cfg"]
    lines = [
        '"""Isaac Lab configuration of one visuo-tactile sensor, written by taccel-lab.',
        "",
        "The camera (TiledCameraCfg) depends on the scene: its figures are in sensor_cfg.json.",
        '"""',
        "",
        "from pathlib import Path",
        "",
        "from isaaclab_contrib.sensors.tacsl_sensor import (",
        "    GelSightRenderCfg,",
        "    VisuoTactileSensorCfg,",
        ")",
        "",
        "RENDER_CFG = GelSightRenderCfg(",
        "    base_data_path=str(Path(__file__).parent),",
        *(f"    {name}={value!r}," for name, value in render.items()),
        ")",
        "SENSOR_CFG = VisuoTactileSensorCfg(",
        "    render_cfg=RENDER_CFG,",
        *(
            f"    {name}={tuple(value) if isinstance(value, list) else value!r},"
            for name, value in sensor.items()
        ),
        ")",
    ]
    return "\n".join(lines) + "\n"
