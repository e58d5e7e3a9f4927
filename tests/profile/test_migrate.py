# SPDX-License-Identifier: Apache-2.0
"""Migration steps are chained, checked and leave their input alone."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import SensorProfile, load_profile, save_profile, validate_profile
from taccel_lab.profile.migrate import STEPS, migrate
from taccel_lab.profile.schema import SCHEMA_VERSION
from taccel_lab.reading.reader import Reader
from taccel_lab.reading.reading import Reading
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_model import ColorModel

OLD = Path(__file__).parent / "old"


def document(version: int) -> dict[str, Any]:
    return tomllib.loads((OLD / f"v{version}" / "profile.toml").read_text())


def old(version: int) -> SensorProfile:
    """The stored profile of a version, which is sound."""
    assert document(version)["schema_version"] == version
    assert validate_profile(OLD / f"v{version}") == []
    return load_profile(OLD / f"v{version}")


def test_steps_are_chained_and_checked() -> None:
    def rename_pad(document: dict[str, Any]) -> dict[str, Any]:
        pad = document["pad"]
        return {"gel": {"thickness_mm": pad["thickness"], "nodes": pad["nodes"]}}

    def rename_nodes(document: dict[str, Any]) -> dict[str, Any]:
        gel = dict(document["gel"])
        gel["node_count"] = gel.pop("nodes")
        return {"gel": gel}

    version_0 = document(0)
    before = copy.deepcopy(version_0)
    migrated = migrate(version_0, current=2, steps={0: rename_pad, 1: rename_nodes})
    assert migrated == {"schema_version": 2, "gel": {"thickness_mm": 4.0, "node_count": 5}}
    assert version_0 == before
    current = {"schema_version": SCHEMA_VERSION, "x": 1}
    assert migrate(current) is current
    with pytest.raises(InputError, match="written by a newer version"):
        migrate({"schema_version": SCHEMA_VERSION + 1})
    with pytest.raises(InputError, match="version 0 is not known"):
        migrate(version_0, current=1, steps={})


def test_every_released_version_has_a_step_and_an_example() -> None:
    assert sorted(STEPS) == list(range(1, SCHEMA_VERSION))
    for version in STEPS:
        assert list(old(version).blocks())


def test_version_1_is_read_as_it_was_and_written_as_the_current_one(tmp_path: Path) -> None:
    """The stored folder holds two tets of one layer, an image and a colour model."""
    profile = old(1)
    assert list(profile.blocks()) == ["sensor", "gel", "material", "camera", "background", "color"]
    assert profile.material.poisson_ratio == 0.48 and profile.material.layers == ()
    assert profile.mesh.tet_layers.tolist() == [0, 0]
    assert profile.grid().mm_per_px_y == 0.031
    assert profile.optical_design() is None
    save_profile(profile, tmp_path / "p")
    text = (tmp_path / "p" / "profile.toml").read_text()
    assert f"schema_version = {SCHEMA_VERSION}\n" in text
    assert load_profile(tmp_path / "p").blocks() == profile.blocks()
    for name in ("mesh.npz", "background.npz", "color_model.safetensors"):
        assert (tmp_path / "p" / name).read_bytes() == (OLD / "v1" / name).read_bytes()


def test_versions_2_and_4_are_read_as_they_were(tmp_path: Path) -> None:
    """The stored folder of version 2 adds markers and a window to that of version 1."""
    profile = old(2)
    assert profile.markers is not None and profile.markers.pitch_y_mm == 2.1
    assert profile.material.model == "neo_hookean" and profile.material.branches == ()
    for lacking in (profile.normals, profile.depth_response, profile.perturbation):
        assert lacking is None
    assert profile.material.provenance.verdict is None
    # Version 4 has a calibrated material, and does not know what it was fitted with.
    profile = old(4)
    assert profile.material.provenance.interval["young_modulus_pa"] == (1.4e5, 1.6e5)
    assert profile.material.fitted_with is None
    save_profile(profile, tmp_path / "p")
    assert "fitted_with" not in (tmp_path / "p" / "profile.toml").read_text()
    assert load_profile(tmp_path / "p").material == profile.material


def test_version_3_is_read_as_it_was(tmp_path: Path) -> None:
    """The stored folder adds a normals block; its networks answer as version 3 had them answer."""
    profile = old(3)
    assert profile.color is not None and profile.color_weights is not None
    config = ColorModelConfig.from_dict(profile.color.architecture)
    assert config.position_bands == 0
    normal = np.array([[0.3, -0.2, np.sqrt(0.87)]])
    change = ColorModel(config, profile.color_weights).predict_pixels(
        np.array([config.width_px + 1]), normal, np.array([-0.3]), np.array([[0.0, 0.0, 1.0]])
    )
    assert change[0] == pytest.approx([-0.03986359, -0.8295059, -2.605404], abs=1e-5)
    model = NormalModel.from_profile(profile)
    features = np.linspace(-1, 1, model.config.input_count, dtype=np.float32)[None]
    tilt, error = model.predict_pixels(features)
    assert tilt[0] == pytest.approx([0.13469668, -0.13960093], abs=1e-6)
    assert error[0] == pytest.approx(1.08504629)
    assert model.config.radius95_sigmas == pytest.approx(2.4477468)
    # With an encoding, which a round trip keeps.
    weights = dict(profile.color_weights)
    first = weights["layer0.weight"]
    weights["layer0.weight"] = np.concatenate([first, 0.1 * np.ones((len(first), 8))], axis=1)
    settings = {**profile.color.architecture, "position_bands": 2}
    block = profile.color.replace(architecture=settings)
    save_profile(profile.with_block(block, weights), tmp_path / "p")
    again = load_profile(tmp_path / "p")
    assert again.color is not None and again.color_weights is not None
    config = ColorModelConfig.from_dict(again.color.architecture)
    assert config.position_bands == 2
    assert np.array_equal(again.color_weights["layer0.weight"], weights["layer0.weight"])
    ColorModel(config, again.color_weights)


def test_versions_5_and_8_do_not_know_how_uncertain_heights_are() -> None:
    """Networks of normals whose heights have no band, and a curve of a grey sensor beside networks
    that tell the error of the reading alone."""

    def read(profile: SensorProfile, method: Any) -> tuple[Reading, dict[str, Any]]:
        assert profile.background_rgb is not None
        reader = Reader(profile, method=method)
        reading = reader.read(profile.background_rgb.astype(float))
        return reading, reading.figures()

    config = NormalModel.from_profile(old(5)).config
    assert (config.height_factor, config.error_length_px, config.cone_deg) == (0.0, 0.0, 90.0)
    for reading, figures in (read(old(5), "auto"), read(old(8), "depth")):
        assert reading.height_sigma_m is None
        assert figures["depth_error_mm"] is None and figures["sigma_of"] is None
        assert "does not say how uncertain" in figures["warnings"][0]
    assert NormalModel.from_profile(old(8)).config.along_factor == 0
    reading, figures = read(old(8), "auto")
    assert reading.height_sigma_m is not None and reading.reading_sigma_m is not None
    # Where nothing touches an image's own rest tells less.
    assert (reading.reading_sigma_m > 0).all()
    assert (reading.reading_sigma_m <= reading.height_sigma_m).all()
    assert figures["sigma_of"] == "reading alone" and figures["depth_error_mm"] > 0
    assert "+- is that of the reading alone" in figures["warnings"][0]


@pytest.mark.parametrize(
    ("version", "later"),
    [
        (6, lambda profile: profile.force or profile.force_weights),
        (7, lambda profile: profile.sensor.recorded),
        (9, lambda profile: profile.view_names()[1:]),
    ],
)
def test_versions_that_only_lack_what_came_later(version: int, later: Any) -> None:
    """The stored folder is that of the version before."""
    profile = old(version)
    assert not later(profile)
    assert profile.blocks() == load_profile(OLD / f"v{version - 1}").blocks()


def test_version_13_is_read_on_the_unit_that_was_captured() -> None:
    assert "unit_share" not in document(13)["normals"]["architecture"]
    assert NormalModel.from_profile(old(13)).config.unit_share == 0.0


def test_version_12_is_read_by_the_ensemble_alone() -> None:
    """The stored folder has no small network; images read as they did."""
    profile = old(12)
    model = NormalModel.from_profile(profile)
    assert "small_hidden" not in document(12)["normals"]["architecture"]
    assert model.config.small_hidden == () and profile.background_rgb is not None
    still = profile.background_rgb.astype(np.float32)
    image = still + np.linspace(-30, 30, still.size, dtype=np.float32).reshape(still.shape)
    found = model.predict(image, still).tilt_rad
    assert found.mean(axis=(0, 1)) == pytest.approx([-0.05969814, -0.01643231], rel=1e-4)


def test_version_11_may_have_a_damping_time_of_zero_alone() -> None:
    """The stored folder has one; any other is refused."""
    old(11)
    damped = document(11)
    assert damped["material"]["damping_time_s"] == 0.0
    damped["material"]["damping_time_s"] = 0.01
    with pytest.raises(InputError, match=r"damping_time_s: must be 0 \(found 0.01\).*branches"):
        migrate(damped)
