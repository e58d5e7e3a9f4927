# SPDX-License-Identifier: Apache-2.0
"""ONNX and safetensors: run and rebuilt, they give what the profile's models give."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open

from taccel_lab.errors import InputError
from taccel_lab.exporters.export import export_profile
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.force_network import marker_planes
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.rest_surface import rest_surface
from tests.exporters.presses import our_image, press_over_rest
from tests.exporters.profiles import with_encoding, with_force, with_normals


@pytest.fixture(scope="module")
def both(mini: SensorProfile) -> SensorProfile:
    return with_normals(mini)


@pytest.mark.thorough(cases=("0",))
@pytest.mark.parametrize("bands", [0, 3])
def test_onnx_runs_to_the_same_image(both: SensorProfile, tmp_path: Path, bands: int) -> None:
    if bands:
        both = with_encoding(both, bands)
    onnxruntime = pytest.importorskip("onnxruntime")
    export_profile(both, "onnx", tmp_path / "out")
    session = onnxruntime.InferenceSession(str(tmp_path / "out" / "color_model.onnx"))
    press = press_over_rest(both)
    rest = rest_surface(both.mesh, both.grid()).normals
    slope = -press.normals[..., :2] / press.normals[..., 2:] - rest[..., :2] / rest[..., 2:]
    raw = np.concatenate([-slope, np.ones((240, 320, 1))], axis=-1)
    normals = raw / np.linalg.norm(raw, axis=-1, keepdims=True)
    v, u = np.mgrid[0:240, 0:320]
    (change,) = session.run(
        ["change_rgb"],
        {
            "u_px": u.ravel().astype(np.float32),
            "v_px": v.ravel().astype(np.float32),
            "normal": normals.reshape(-1, 3).astype(np.float32),
            "rest_normal": rest.reshape(-1, 3).astype(np.float32),
            "displacement_mm": press.displacement_mm().ravel().astype(np.float32),
        },
    )
    image = np.clip(both.background_rgb + change.reshape(240, 320, 3), 0, 255)
    # FP32 over changes of some 50 levels.
    assert np.abs(image - our_image(both, press)).max() < 5e-4


def test_onnx_normals_are_those_of_the_model(both: SensorProfile, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    document = export_profile(both, "onnx", tmp_path / "out")
    assert document["approximations"]["color_largest_difference"] < 1e-5
    assert document["approximations"]["normals_largest_difference"] < 1e-5
    session = onnxruntime.InferenceSession(str(tmp_path / "out" / "normal_model.onnx"))
    model = NormalModel.from_profile(both)
    features = np.random.default_rng(7).normal(0, 1, (1000, model.config.input_count))
    features = features.astype(np.float32)
    tilt, error = session.run(["tilt_rad", "error_rad"], {"features": features})
    wanted_tilt, wanted_error = model.predict_pixels(features)
    np.testing.assert_allclose(tilt, wanted_tilt, atol=1e-5)
    np.testing.assert_allclose(error, wanted_error, rtol=1e-5)
    described = json.loads((tmp_path / "out" / "models.json").read_text())
    assert described["normals"]["features"] == list(model.config.features)


@pytest.mark.thorough
@pytest.mark.parametrize("markers", [False, True])
def test_onnx_forces_are_those_of_the_model(
    mini: SensorProfile, tmp_path: Path, markers: bool
) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    profile = with_force(mini, markers=markers)
    document = export_profile(profile, "onnx", tmp_path / "out")
    assert document["approximations"]["force_largest_difference"] < 1e-5
    model, rng = ForceModel.from_profile(profile), np.random.default_rng(3)
    image = rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    dots = rng.uniform(0, 240, (30, 2)), rng.normal(0, 2, (30, 2))
    assert profile.background_rgb is not None
    found = model.read(image, profile.background_rgb, dots if markers else None)
    change = image - profile.background_rgb.astype(np.float32)
    feeds = {"change": change.transpose(2, 0, 1)[None]}
    if markers:
        feeds["markers"] = marker_planes(*dots, model.config, profile.grid())[None]
    session = onnxruntime.InferenceSession(str(tmp_path / "out" / "force_model.onnx"))
    names = ["force_n", "moment_nmm", "area_mm2", "sigma", "patch_forces_n", "distances"]
    told = dict(zip(names, session.run(names, feeds), strict=True))
    wanted = {
        "force_n": found.force_n, "moment_nmm": found.moment_nmm, "area_mm2": [found.area_mm2],
        "sigma": found.sigma, "patch_forces_n": found.patch_forces_n.transpose(2, 0, 1),
        "distances": found.distances,
    }  # fmt: skip
    for name, value in wanted.items():
        np.testing.assert_allclose(told[name][0], value, rtol=2e-4, atol=2e-4, err_msg=name)


def test_a_graph_that_differs_from_its_model_is_refused(
    both: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when a later colour model has a setting that the exporter does not know."""
    plain = ColorModel.predict_pixels
    monkeypatch.setattr(ColorModel, "predict_pixels", lambda *args: 1.01 * plain(*args))
    with pytest.raises(InputError, match="differs from its model"):
        export_profile(both, "onnx", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_the_package_it_says_how_to_get_it(
    both: SensorProfile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"taccel-lab\[onnx\]"):
        export_profile(both, "onnx", tmp_path / "out")


@pytest.mark.parametrize("bands", [0, 2])
def test_safetensors_rebuild_the_models(both: SensorProfile, tmp_path: Path, bands: int) -> None:
    if bands:
        both = with_encoding(both, bands)
    export_profile(both, "safetensors", tmp_path / "out")
    with safe_open(tmp_path / "out" / "color_model.safetensors", "numpy") as file:
        settings = json.loads(file.metadata()["architecture"])
        weights = {name: file.get_tensor(name) for name in file.keys()}
        assert file.metadata()["sensor"] == "gelsight_mini"
    model = ColorModel(ColorModelConfig.from_dict(settings), weights)
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(50, 3))
    arguments = (rng.integers(0, 1000, 50), normals, normals[:, 0], normals[::-1])
    assert both.color is not None and both.color_weights is not None
    ours = ColorModel(ColorModelConfig.from_dict(both.color.architecture), both.color_weights)
    assert np.array_equal(model.predict_pixels(*arguments), ours.predict_pixels(*arguments))
    described = json.loads((tmp_path / "out" / "models.json").read_text())
    assert set(described) == {"color", "normals"}
    steepest_deg = both.color.provenance.valid_region["surface_tilt_deg"][1]
    assert described["color"]["cone_deg"] == steepest_deg == 40.0
    for key in described:
        assert (tmp_path / "out" / described[key]["file"]).is_file()


@pytest.mark.parametrize("name", ["onnx", "safetensors"])
def test_one_network_is_enough_and_the_other_is_named(
    name: str, mini: SensorProfile, tmp_path: Path
) -> None:
    document = export_profile(mini, name, tmp_path / "out")
    assert "taccel-lab calibrate normals" in document["left_out"]["normals"]
    assert "color" in document["carries"]
