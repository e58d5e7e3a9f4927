# SPDX-License-Identifier: Apache-2.0
"""The Isaac Lab folder, rendered by the formulas of its renderer; its configuration file runs."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path

import cv2
import numpy as np
import pytest

from taccel_lab.exporters.export import export_profile
from taccel_lab.exporters.frames import LINK_FROM_GEL
from taccel_lab.profile import SensorProfile
from tests.exporters.presses import our_image, press_over_rest, require_upright


def isaac_render(data: Path, penetration_m: np.ndarray, cfg: dict) -> np.ndarray:
    """As GelsightRender.render, less the smoothing of the height map."""
    table = np.load(data / cfg["calib_path"])
    background = cv2.cvtColor(
        np.asarray(cv2.imread(str(data / cfg["background_path"]))), cv2.COLOR_BGR2RGB
    )
    height_px = penetration_m * -1000 / cfg["mm_per_pixel"]
    dzdx, dzdy = np.gradient(height_px)
    steep = np.hypot(dzdx, dzdy)
    direction = np.where(steep == 0, 0.0, np.arctan2(dzdx, dzdy))
    steps = cfg["num_bins"] - 1
    i = np.clip(np.floor(np.arctan(steep) / (0.5 * np.pi / steps)).astype(int), 0, steps)
    j = np.clip(np.floor((direction + np.pi) / (2 * np.pi / steps)).astype(int), 0, steps)
    x, y = np.meshgrid(range(cfg["image_width"]), range(cfg["image_height"]))
    terms = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    change = [(terms * table[f"grad_{c}"][i, j]).sum(axis=-1) for c in "rgb"]
    return np.clip(np.stack(change, axis=-1) + background, 0, 255)


@pytest.mark.thorough
def test_the_renderer_shows_the_press(mini: SensorProfile, tmp_path: Path) -> None:
    document = export_profile(mini, "isaac-lab", tmp_path / "out")
    cfg = json.loads((tmp_path / "out" / "sensor_cfg.json").read_text())
    data = tmp_path / "out" / cfg["render_cfg"]["sensor_data_dir_name"]
    assert cfg["render_cfg"]["num_bins"] == 120
    assert np.load(data / "polycalib.npz")["grad_r"].shape == (120, 120, 6)
    press = press_over_rest(mini)
    image = isaac_render(data, -press.height_m, cfg["render_cfg"])
    require_upright(image, our_image(mini, press), 42)
    assert document["approximations"]["background_jpeg_max_levels"] < 6
    assert np.array_equal(np.load(data / "real_bg.npy"), mini.background_rgb)


def test_camera_stands_behind_the_gel_and_sees_its_extent(
    mini: SensorProfile, tmp_path: Path
) -> None:
    from scipy.spatial.transform import Rotation

    export_profile(mini, "isaac-lab", tmp_path / "out")
    camera = json.loads((tmp_path / "out" / "sensor_cfg.json").read_text())["camera_cfg"]
    # x of the link points out of the gel.
    assert camera["offset_pos_m"][0] == pytest.approx(-camera["distance_m"])
    focal = camera["focal_length"] / camera["horizontal_aperture"]
    assert camera["distance_m"] / focal == pytest.approx(320 * 0.0634e-3)
    # ROS: z along the view, x right: the camera's axes are those of the gel frame.
    turned = Rotation.from_quat(camera["offset_quat_xyzw"]).as_matrix()
    np.testing.assert_allclose(turned, LINK_FROM_GEL, atol=1e-12)


def test_a_turned_camera_keeps_the_order_of_its_quaternion(
    mini: SensorProfile, tmp_path: Path
) -> None:
    from scipy.spatial.transform import Rotation

    assert mini.optics is not None
    turn = Rotation.from_euler("xyz", [0.1, -0.2, 0.3])
    optics = mini.optics.model_copy(update={"rotation": tuple(turn.as_quat())})
    turned = mini.with_block(optics)
    export_profile(turned, "isaac-lab", tmp_path / "out")
    camera = json.loads((tmp_path / "out" / "sensor_cfg.json").read_text())["camera_cfg"]
    found = Rotation.from_quat(camera["offset_quat_xyzw"]).as_matrix()
    np.testing.assert_allclose(found, LINK_FROM_GEL @ turn.as_matrix(), atol=1e-9)


def test_the_configuration_file_runs(
    mini: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_profile(mini, "isaac-lab", tmp_path / "out")
    made: dict[str, dict] = {}

    def recorder(name: str) -> type:
        def init(self: object, **values: object) -> None:
            made[name] = values

        return type(name, (), {"__init__": init})

    module = types.ModuleType("isaaclab_contrib.sensors.tacsl_sensor")
    for name in ("GelSightRenderCfg", "VisuoTactileSensorCfg"):
        setattr(module, name, recorder(name))
    for parent in ("isaaclab_contrib", "isaaclab_contrib.sensors"):
        monkeypatch.setitem(sys.modules, parent, types.ModuleType(parent))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    path = tmp_path / "out" / "sensor_cfg.py"
    exec(compile(path.read_text(), str(path), "exec"), {"__file__": str(path), "__name__": "x"})
    render, sensor = made["GelSightRenderCfg"], made["VisuoTactileSensorCfg"]
    folder = Path(str(render["base_data_path"])) / str(render["sensor_data_dir_name"])
    assert (folder / "bg.jpg").is_file()
    assert (render["image_width"], render["image_height"]) == (320, 240)
    assert render["mm_per_pixel"] == pytest.approx(0.0634)
    assert sensor["tactile_array_size"] == (7, 9)
    assert sensor["friction_coefficient"] == mini.material.friction_coefficient
    # E A / t of 1/63 of the gel under 460 kPa: 25.25 x 20.75 mm over 4 mm.
    assert sensor["normal_contact_stiffness"] == pytest.approx(
        460e3 * 25.25e-3 * 20.75e-3 / 63 / 4e-3, rel=0.02
    )
    # Shear: G / E = 1 / (2 (1 + 0.46)).
    assert sensor["tangential_stiffness"] == pytest.approx(
        sensor["normal_contact_stiffness"] / 2.92
    )
