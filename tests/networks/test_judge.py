# SPDX-License-Identifier: Apache-2.0
"""Networks of a profile are judged by their answers, in numpy, wherever a profile is made."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks import judge
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig, patch_forces
from taccel_lab.networks.judge import network_fault
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import require_answers
from taccel_lab.profile.sensor_profile import ARRAY_FIELDS
from taccel_lab.signals.force_network import forward, patch_centers_mm
from tests.exporters.profiles import mini_profile, with_force, with_normals

COLOR = ColorModelConfig(40, 30, hidden=(16, 8))
NORMAL = NormalModelConfig(40, 30, members=3, hidden=(16, 8))
FORCE = ForceModelConfig(40, 30, columns=4, rows=3, patch_px=4, widths=(3, 5), blocks=2, hidden=6)
KEYS = {ColorModelConfig: "color", NormalModelConfig: "normals", ForceModelConfig: "force"}
LAST = {"color": "layer2", "normals": "layer2", "force": "patch"}
Config = ColorModelConfig | NormalModelConfig | ForceModelConfig
Weights = dict[str, np.ndarray]


def weights_of(config: Config, seed: int) -> Weights:
    rng = np.random.default_rng(seed)
    shapes = config.weight_shapes()
    return {n: rng.normal(0, s[-1] ** -0.5, s).astype(np.float32) for n, s in shapes.items()}


def fault(config: Config, weights: Weights, size_px: tuple[int, int] = (40, 30)) -> str | None:
    return network_fault(KEYS[type(config)], config.to_dict(), weights, size_px, {})


def scaled(key: str, weights: Weights, factor: float) -> Weights:
    """With the last layer multiplied."""
    return {
        name: value * np.float32(factor if name.startswith(LAST[key]) else 1)
        for name, value in weights.items()
    }


@pytest.mark.parametrize("config", [COLOR, NORMAL, FORCE])
@pytest.mark.parametrize("seed", range(3))
def test_networks_whose_answers_no_sensor_gives_are_refused(config, seed):
    key, weights = KEYS[type(config)], weights_of(config, seed)
    assert fault(config, weights) is None
    for factor in (1e4 if key == "force" else 100.0, 1e38):
        said = fault(config, scaled(key, weights, factor))
        assert said is not None and " answers " in said and "or scaled" in said
    assert "40x30 px, the camera block says 40x31" in str(fault(config, weights, (40, 31)))


def test_a_scale_of_another_network_is_refused():
    weights = weights_of(COLOR, 0)
    wrong = dataclasses.replace(COLOR, output_scale=3200.0)
    assert "color model answers up to" in str(fault(wrong, weights))
    require_answers("it", np.full(100, 1.0), 0.5, 2.0, "N", "more is none")
    with pytest.raises(InputError, match="it answers up to inf N, but more is none"):
        require_answers("it", np.full(100, np.nan), 0.5, 2.0, "N", "more is none")
    with pytest.raises(InputError, match=r"it answers up to 0\.1 N, but any touch"):
        require_answers("it", np.full(100, 0.1), 0.5, 2.0, "N", "more is none")


@pytest.mark.parametrize("markers", [False, True])
def test_forces_are_those_that_images_are_read_with(markers):
    config = dataclasses.replace(FORCE, markers=markers, patch_scale_n=(0.5, 1.0, 2.0))
    weights = weights_of(config, 4)
    change = np.random.default_rng(5).normal(size=(2, 3, *config.input_px)).astype(np.float32)
    moved = torch.zeros(2, 3, 3, 4)
    moved[:, 2] = 1.0
    centers = patch_centers_mm(config, PixelGrid(40, 30, 0.1, 0.12)).astype(np.float32)
    found = forward(
        {name: torch.from_numpy(value) for name, value in weights.items()},
        config,
        torch.from_numpy(change),
        moved if markers else None,
        torch.from_numpy(centers),
    )
    wanted = found["patches"].numpy()
    # Sums of FP32 are rounded by their largest summands, as large as the largest force.
    atol = 1e-5 * float(np.abs(wanted).max())
    np.testing.assert_allclose(patch_forces(config, weights, change), wanted, rtol=1e-4, atol=atol)


@pytest.mark.parametrize("key", ["color", "normals", "force"])
def test_every_way_to_a_profile_judges_its_networks(key):
    sound = with_force(with_normals(mini_profile()))
    field = ARRAY_FIELDS[key]
    weights = {name: 1e5 * value for name, value in getattr(sound, field).items()}
    for make in (
        lambda: dataclasses.replace(sound, **{field: weights}),
        lambda: sound.with_block(sound.blocks()[key], weights),
    ):
        with pytest.raises(InputError, match=f"^{key}: the .* answers "):
            make()


def test_a_network_is_asked_once(monkeypatch):
    asked: list[str] = []
    plain = judge._judge
    monkeypatch.setattr(judge, "_faults", {})
    monkeypatch.setattr(judge, "_judge", lambda key, *rest: (asked.append(key), plain(key, *rest)))
    sound = with_normals(mini_profile())
    for _ in range(3):
        dataclasses.replace(sound, material=sound.material.replace(young_modulus_pa=2e5))
    assert sorted(asked) == ["color", "normals"]
