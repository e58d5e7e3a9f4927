# SPDX-License-Identifier: Apache-2.0
"""The Isaac Lab folder, rendered by the formulas of its renderer; its configuration file runs."""

from __future__ import annotations

import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.profile import SensorProfile
from tests.exporters.conftest import Exported
from tests.exporters.consumers import isaac_render
from tests.exporters.profiles import our_image, press_over_rest, require_upright


@pytest.mark.thorough
def test_the_renderer_shows_the_press(mini: SensorProfile, exported: Exported) -> None:
    out, document = exported("isaac-lab")
    cfg = json.loads((out / "sensor_cfg.json").read_text())["render_cfg"]
    data = out / cfg["sensor_data_dir_name"]
    assert cfg["num_bins"] == 120
    assert np.load(data / "polycalib.npz")["grad_r"].shape == (120, 120, 6)
    press = press_over_rest(mini)
    require_upright(isaac_render(data, -press.height_m, cfg), our_image(mini, press), 42)
    assert document["approximations"]["background_jpeg_max_levels"] < 6
    assert np.array_equal(np.load(data / "real_bg.npy"), mini.background_rgb)


def test_the_configuration_file_runs(exported: Exported, monkeypatch: pytest.MonkeyPatch) -> None:
    out, _ = exported("isaac-lab")
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
    path = out / "sensor_cfg.py"
    exec(compile(path.read_text(), str(path), "exec"), {"__file__": str(path), "__name__": "x"})
    render, sensor = made["GelSightRenderCfg"], made["VisuoTactileSensorCfg"]
    folder = Path(str(render.pop("base_data_path"))) / str(render["sensor_data_dir_name"])
    assert (folder / "bg.jpg").is_file() and sensor.pop("render_cfg")
    # The same figures as in the JSON beside it; lists are tuples there.
    stored = json.loads((out / "sensor_cfg.json").read_text())
    assert render == stored["render_cfg"] and sensor["tactile_array_size"] == (7, 9)
    assert {**sensor, "tactile_array_size": [7, 9]} == stored["sensor_cfg"]
