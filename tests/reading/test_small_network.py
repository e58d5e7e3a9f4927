# SPDX-License-Identifier: Apache-2.0
"""The small network that reads for an ensemble: rest is exact, and where it is off the ensemble
reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from taccel_lab.networks.normal_settings import SMALL, NormalModelConfig, ensemble_of
from taccel_lab.reading.blocks import LARGEST_PX
from taccel_lab.reading.room import STEP, Room
from taccel_lab.reading.slopes import RAYLEIGH_MEAN, NormalModel
from tests.networks.weights import random_weights

HEIGHT, WIDTH = 144, 192
ENSEMBLE = NormalModelConfig(
    WIDTH, HEIGHT, scales_px=(1.0, 3.0), slope_scales_px=(3.0,), members=3, hidden=(16, 12)
)
BOTH = replace(ENSEMBLE, small_hidden=(10, 8))
V, U = np.mgrid[:HEIGHT, :WIDTH]
STILL = np.random.default_rng(1).uniform(60, 190, (HEIGHT, WIDTH, 3)).astype(np.float32)
AWAY = np.hypot(U - 96.0, V - 72.0)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def dented() -> np.ndarray:
    """A dent in the middle, and nothing beyond 50 px of it."""
    lean = np.where(AWAY < 30, AWAY / 30, np.exp(-(AWAY - 30) / 6)) * (AWAY < 50)
    way = np.stack([U - 96.0, V - 72.0, 30.0 - AWAY], axis=-1) / np.maximum(AWAY, 1.0)[..., None]
    return (STILL + 50.0 * lean[..., None] * np.clip(way, -1, 1)).astype(np.float32)


def pair(log_off: float, by_column: float = 0.0) -> tuple[NormalModel, NormalModel]:
    """An ensemble alone, and with a small network that expects an error of e^-2 and to be off by
    e^``log_off``, times e^``by_column`` at the right border and its inverse at the left."""
    weights = random_weights(BOTH, spread=0.3)
    last, bias = weights[f"{SMALL}layer2.weight"], weights[f"{SMALL}layer2.bias"]
    last[2:], bias[2:] = 0.0, (-2.0, log_off)
    if by_column:
        # Neuron 0 carries the column through: silu(x + 20) is x + 20.
        column = BOTH.features.index("u")
        for i, entry in ((0, column), (1, 0)):
            weights[f"{SMALL}layer{i}.weight"][0] = 0.0
            weights[f"{SMALL}layer{i}.weight"][0, entry] = 1.0
            weights[f"{SMALL}layer{i}.bias"][0] = 20.0
        last[3, 0], bias[3] = by_column, log_off - 40.0 * by_column
        last[:2, 0] = 0.0
    return NormalModel(ENSEMBLE, ensemble_of(weights)), NormalModel(BOTH, weights)


@pytest.mark.parametrize("log_off", [-9.0, 0.0])
def test_unchanged_pixels_read_as_rest_exactly(log_off: float) -> None:
    """By the small network, and by the ensemble in its place."""
    _, both = pair(log_off)
    assert not both.predict(STILL, STILL).tilt_rad.any()
    mask = (np.abs(U - 170) > 5) | (np.abs(V - 20) > 5)
    found = both.predict(dented(), STILL, mask=mask).tilt_rad
    assert (found[AWAY > 90] == 0).all() and (found != 0).any()


def test_the_ensemble_reads_what_the_small_network_is_not_sure_of() -> None:
    image = dented()
    alone, unsure = pair(0.0)
    wanted, found = alone.predict(image, STILL), unsure.predict(image, STILL)
    assert np.abs(found.tilt_rad - wanted.tilt_rad).max() < 1e-5
    assert found.sigma_deg == pytest.approx(wanted.sigma_deg, rel=1e-4)
    # Sure to the left of the middle; blocks of one size, as slopes elsewhere say which are smaller.
    _, sure = pair(-9.0)
    _, half = pair(-2.0 + np.log(0.5), by_column=3.0)
    wanted, small, found = (
        model.predict(image, STILL, every=LARGEST_PX).tilt_rad for model in (alone, sure, half)
    )
    right = np.arange(WIDTH // 8) >= WIDTH // 16
    assert np.abs(small - wanted)[:, right].max() > 0.05
    assert np.abs(found - wanted)[:, right].max() < 1e-5
    assert np.abs(found - wanted)[:, ~right].max() > 0.05


def test_what_it_is_off_is_one_more_error() -> None:
    _, sure = pair(-9.0)
    _, less = pair(-2.0 + np.log(0.49))
    image = dented()
    expected = np.degrees(np.exp(-2.0)) / RAYLEIGH_MEAN
    assert sure.predict(image, STILL).sigma_deg == pytest.approx(expected, rel=1e-4)
    assert less.predict(image, STILL).sigma_deg == pytest.approx(
        np.hypot(1, 0.49) * expected, rel=1e-4
    )


def test_a_member_that_did_not_see_a_press_reads_it_alone() -> None:
    alone, both = pair(-9.0)
    image = dented()
    wanted, found = (model.predict(image, STILL, left_out=1) for model in (alone, both))
    assert np.abs(found.tilt_rad - wanted.tilt_rad).max() < 1e-5


def test_a_room_of_fixed_size_reads_the_same() -> None:
    """As a GPU's recorded graph asks for it."""
    _, half = pair(-2.0 + np.log(0.5), by_column=3.0)
    known = half.predict(dented(), STILL, every=LARGEST_PX).tilt_rad
    here, images = Room(), torch.from_numpy(np.stack([dented()] * 3))
    for _ in range(6):
        with here.entered():
            found = half.predict(images, STILL, every=LARGEST_PX).tilt_rad
        if here.enough(here.asked().tolist()):
            break
    assert np.abs(found.numpy() - known).max() < 1e-5
    left = here.known("blocks of 8 px left to the ensemble")
    assert left is not None and left >= STEP


def test_several_images_are_read_as_each_of_them() -> None:
    _, half = pair(-2.0 + np.log(0.5), by_column=3.0)
    image = dented()
    images = np.stack([image, STILL, image[:, ::-1]])
    together = half.predict(images, STILL, every=LARGEST_PX).tilt_rad
    for each, found in zip(images, together, strict=True):
        assert (half.predict(each, STILL, every=LARGEST_PX).tilt_rad == found).all()
