# SPDX-License-Identifier: Apache-2.0
"""ONNX and safetensors: run and rebuilt, they give what the profile's models give."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import load_file

from taccel_lab.errors import InputError
from taccel_lab.exporters.export import export_profile
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.profile import SensorProfile
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.force_network import marker_planes
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import rest_surface
from tests.exporters.profiles import (
    our_image,
    press_over_rest,
    with_encoding,
    with_force,
    with_normals,
)


@pytest.fixture(scope="module")
def both(mini: SensorProfile) -> SensorProfile:
    return with_normals(mini)


def onnx_session(folder: Path, name: str) -> Any:
    onnxruntime = pytest.importorskip("onnxruntime")
    return onnxruntime.InferenceSession(str(folder / f"{name}_model.onnx"))


@pytest.mark.thorough(cases=("0",))
@pytest.mark.parametrize("bands", [0, 3])
def test_onnx_runs_to_the_same_image(both: SensorProfile, tmp_path: Path, bands: int) -> None:
    both = with_encoding(both, bands) if bands else both
    export_profile(both, "onnx", tmp_path / "out")
    press = press_over_rest(both)
    rest = rest_surface(both.mesh, both.grid()).normals
    slope = -press.normals[..., :2] / press.normals[..., 2:] - rest[..., :2] / rest[..., 2:]
    v, u = np.mgrid[0:240, 0:320]
    inputs = {
        "u_px": u.ravel(), "v_px": v.ravel(),
        "normal": normals_from_slopes(slope).reshape(-1, 3), "rest_normal": rest.reshape(-1, 3),
        "displacement_mm": press.displacement_mm().ravel(),
    }  # fmt: skip
    feeds = {name: value.astype(np.float32) for name, value in inputs.items()}
    (change,) = onnx_session(tmp_path / "out", "color").run(["change_rgb"], feeds)
    image = np.clip(both.background_rgb + change.reshape(240, 320, 3), 0, 255)
    # FP32 over changes of some 50 levels.
    assert np.abs(image - our_image(both, press)).max() < 5e-4


def test_onnx_normals_are_those_of_the_model(both: SensorProfile, tmp_path: Path) -> None:
    document = export_profile(both, "onnx", tmp_path / "out")
    assert document["approximations"]["color_largest_difference"] < 1e-5
    assert document["approximations"]["normals_largest_difference"] < 1e-5
    model = NormalModel.from_profile(both)
    features = np.random.default_rng(7).normal(0, 1, (1000, model.config.input_count))
    features = features.astype(np.float32)
    session = onnx_session(tmp_path / "out", "normal")
    tilt, error = session.run(["tilt_rad", "error_rad"], {"features": features})
    wanted_tilt, wanted_error = model.predict_pixels(features)
    np.testing.assert_allclose(tilt, wanted_tilt, atol=1e-5)
    np.testing.assert_allclose(error, wanted_error, rtol=1e-5)
    described = json.loads((tmp_path / "out" / "models.json").read_text())
    assert described["normals"]["features"] == list(model.config.features)


def test_the_small_network_goes_along(both: SensorProfile, tmp_path: Path) -> None:
    """Its weights beside the ensemble's, and the formula that it answers by."""
    export_profile(both, "safetensors", tmp_path / "out")
    weights = load_file(tmp_path / "out" / "normal_model.safetensors")
    described = json.loads((tmp_path / "out" / "models.json").read_text())["normals"]
    assert described["architecture"]["small_hidden"] == [7, 5] and "small.*" in described["formula"]
    model = NormalModel.from_profile(both)
    again = NormalModel(NormalModelConfig.from_dict(described["architecture"]), weights)
    assert both.background_rgb is not None
    still = both.background_rgb.astype(np.float32)
    image = np.clip(still + 20.0 * np.sin(np.arange(320) / 15.0)[None, :, None], 0, 255)
    found, wanted = (each.predict(image, still) for each in (again, model))
    assert np.array_equal(found.tilt_rad, wanted.tilt_rad) and found.tilt_rad.any()


@pytest.mark.thorough
@pytest.mark.parametrize("markers", [False, True])
def test_onnx_forces_are_those_of_the_model(
    mini: SensorProfile, tmp_path: Path, markers: bool
) -> None:
    profile = with_force(mini, markers=markers)
    document = export_profile(profile, "onnx", tmp_path / "out")
    assert document["approximations"]["force_largest_difference"] < 1e-5
    model, rng = ForceModel.from_profile(profile), np.random.default_rng(3)
    image = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    dots = rng.uniform(0, 240, (30, 2)), rng.normal(0, 2, (30, 2))
    assert profile.background_rgb is not None
    read = model.read(image, profile.background_rgb, dots if markers else None)
    change = image - profile.background_rgb.astype(np.float32)
    feeds = {"change": change.transpose(2, 0, 1)[None]}
    if markers:
        feeds["markers"] = marker_planes(*dots, model.config, profile.grid())[None]
    wanted = {
        "force_n": read.force_n, "moment_nmm": read.moment_nmm, "area_mm2": [read.area_mm2],
        "sigma": read.sigma, "patch_forces_n": read.patch_forces_n.transpose(2, 0, 1),
        "distances": read.distances,
    }  # fmt: skip
    found = onnx_session(tmp_path / "out", "force").run(list(wanted), feeds)
    for (name, value), values in zip(wanted.items(), found, strict=True):
        np.testing.assert_allclose(values[0], value, rtol=2e-4, atol=2e-4, err_msg=name)


def test_what_cannot_be_a_graph_is_refused(
    both: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a later colour model has a setting that the exporter does not know."""
    plain = ColorModel.predict_pixels
    with monkeypatch.context() as patch, pytest.raises(InputError, match="differs from its model"):
        patch.setattr(ColorModel, "predict_pixels", lambda *args: 1.01 * plain(*args))
        export_profile(both, "onnx", tmp_path / "out")
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"taccel-lab\[onnx\]"):
        export_profile(both, "onnx", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("bands", [0, 2])
def test_safetensors_rebuild_the_models(both: SensorProfile, tmp_path: Path, bands: int) -> None:
    both = with_encoding(both, bands) if bands else both
    export_profile(both, "safetensors", tmp_path / "out")
    with safe_open(tmp_path / "out" / "color_model.safetensors", "numpy") as file:
        settings = json.loads(file.metadata()["architecture"])
        weights = {name: file.get_tensor(name) for name in file.keys()}
        assert file.metadata()["sensor"] == "gelsight_mini"
    assert both.color is not None and both.color_weights is not None
    assert settings == json.loads(json.dumps(both.color.architecture))
    assert ColorModel(ColorModelConfig.from_dict(settings), weights)
    assert set(weights) == set(both.color_weights)
    assert all(np.array_equal(weights[name], both.color_weights[name]) for name in weights)
    described = json.loads((tmp_path / "out" / "models.json").read_text())
    assert set(described) == {"color", "normals"}
    steepest_deg = both.color.provenance.valid_region["surface_tilt_deg"][1]
    assert described["color"]["cone_deg"] == steepest_deg == 40.0
    assert all((tmp_path / "out" / model["file"]).is_file() for model in described.values())


@pytest.mark.parametrize("name", ["onnx", "safetensors"])
def test_one_network_is_enough_and_the_other_is_named(
    name: str, mini: SensorProfile, tmp_path: Path
) -> None:
    document = export_profile(mini, name, tmp_path / "out")
    assert "taccel-lab calibrate normals" in document["left_out"]["normals"]
    assert "color" in document["carries"]
