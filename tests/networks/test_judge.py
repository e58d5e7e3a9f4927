# SPDX-License-Identifier: Apache-2.0
"""Networks of a profile are judged by their answers, in numpy, wherever a profile is made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks import judge
from taccel_lab.networks.force_settings import patch_forces
from taccel_lab.networks.judge import network_fault
from taccel_lab.networks.settings import require_answers
from taccel_lab.profile.sensor_profile import ARRAY_FIELDS
from taccel_lab.signals.force_network import forward, patch_centers_mm
from tests.exporters.profiles import mini_profile, with_force, with_normals
from tests.networks.weights import COLOR, FORCE, NORMAL, random_weights

NETWORKS = {"color": (COLOR, "layer2"), "normals": (NORMAL, "layer2"), "force": (FORCE, "patch")}
"""Settings, and the name of the last layer."""


@pytest.mark.parametrize("key", NETWORKS)
@pytest.mark.parametrize("seed", range(3))
def test_networks_whose_answers_no_sensor_gives_are_refused(key, seed):
    config, last = NETWORKS[key]

    def fault(factor=1.0, height_px=30):
        weights = {
            name: value * np.float32(factor if name.startswith(last) else 1)
            for name, value in random_weights(config, seed).items()
        }
        return network_fault(key, config.to_dict(), weights, (40, height_px), {})

    assert fault() is None
    for factor in (1e4 if key == "force" else 100.0, 1e38):
        assert " answers " in fault(factor) and "or scaled" in fault(factor)
    assert "40x30 px, the camera block says 40x31" in fault(height_px=31)


def test_a_scale_of_another_network_is_refused():
    wrong = replace(COLOR, output_scale=3200.0).to_dict()
    said = network_fault("color", wrong, random_weights(COLOR), (40, 30), {})
    assert "color model answers up to" in str(said)


def test_a_small_network_that_no_sensor_has_is_refused():
    config = replace(NORMAL, small_hidden=(6, 5))
    weights = random_weights(config)

    def fault(factor: float) -> str | None:
        name = "small.layer2.weight"
        scaled = {**weights, name: weights[name] * np.float32(factor)}
        return network_fault("normals", config.to_dict(), scaled, (40, 30), {})

    assert fault(1.0) is None
    assert "normal model's small network answers up to" in str(fault(100.0))
    without = {name: value for name, value in weights.items() if not name.startswith("small.")}
    said = network_fault("normals", config.to_dict(), without, (40, 30), {})
    assert "do not fit its settings: small.layer0.bias" in str(said)


def test_answers_lie_between_the_least_and_the_most():
    bounds = (0.5, 2.0, "N", "more is none")
    require_answers("it", np.full(100, 1.0), *bounds)
    for answer, words in ((np.nan, "inf N, but more is none"), (0.1, r"0\.1 N, but any touch")):
        with pytest.raises(InputError, match=f"it answers up to {words}"):
            require_answers("it", np.full(100, answer), *bounds)


@pytest.mark.parametrize("markers", [False, True])
def test_forces_are_those_that_images_are_read_with(markers):
    config = replace(FORCE, markers=markers, patch_scale_n=(0.5, 1.0, 2.0))
    weights = random_weights(config, 4)
    change = np.random.default_rng(5).normal(size=(2, 3, *config.input_px)).astype(np.float32)
    moved = torch.zeros(2, 3, 3, 4)
    moved[:, 2] = 1.0
    centers = patch_centers_mm(config, PixelGrid(40, 30, 0.1, 0.12)).astype(np.float32)
    tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
    given = (torch.from_numpy(change), moved if markers else None, torch.from_numpy(centers))
    wanted = forward(tensors, config, *given)["patches"].numpy()
    # Sums of FP32 are rounded by their largest summands, as large as the largest force.
    atol = 1e-5 * float(np.abs(wanted).max())
    np.testing.assert_allclose(patch_forces(config, weights, change), wanted, rtol=1e-4, atol=atol)


@pytest.mark.parametrize("key", NETWORKS)
def test_every_way_to_a_profile_judges_its_networks(key):
    sound = with_force(with_normals(mini_profile()))
    field = ARRAY_FIELDS[key]
    weights = {name: 1e5 * value for name, value in getattr(sound, field).items()}
    for make in (
        lambda: replace(sound, **{field: weights}),
        lambda: sound.with_block(sound.blocks()[key], weights),
    ):
        with pytest.raises(InputError, match=f"^{key}: the .* answers "):
            make()


def test_a_network_is_asked_once(monkeypatch):
    asked = []
    plain = judge._judge
    monkeypatch.setattr(judge, "_faults", {})
    monkeypatch.setattr(judge, "_judge", lambda key, *rest: (asked.append(key), plain(key, *rest)))
    sound = with_normals(mini_profile())
    for _ in range(3):
        replace(sound, material=sound.material.replace(young_modulus_pa=2e5))
    assert sorted(asked) == ["color", "normals"]
