# SPDX-License-Identifier: Apache-2.0
"""What a force model keeps whatever its weights are: sums, moments, the order of markers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.force_settings import (
    MARKER_UNIT_MM,
    ForceModelConfig,
    color_directions,
)
from taccel_lab.signals import resultant_wrench
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.force_network import (
    area_matrix,
    color_reach,
    marker_planes,
    moment_of,
    patch_centers_mm,
    reduced,
)
from tests.networks.weights import FORCE, random_weights

GRID = PixelGrid(40, 30, 0.1, 0.12, 18.0, 15.0)
SETTINGS = replace(
    FORCE, stiffness_relative=0.2, young_modulus_pa=2e5, most=(400.0,) * 4,
    distance_limits=(50.0, 50.0, 300.0),
)  # fmt: skip
CENTERS = patch_centers_mm(SETTINGS, GRID)


def made_up(**changes: Any) -> ForceModel:
    config = replace(SETTINGS, **changes)
    weights = random_weights(config, spread=0.4)
    return ForceModel(config, {**weights, "colors.most": np.full(26, 100.0)}, GRID)


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (30, 40, 3), dtype=np.uint8)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_patches_add_up_and_errors_hold_what_is_not_known_of_the_modulus(seed):
    found = made_up().read(picture(seed), picture(seed + 1))
    np.testing.assert_allclose(found.patch_forces_n.sum(axis=(0, 1)), found.force_n, rtol=1e-9)
    assert (found.sigma[:3] >= 0.19999 * np.abs(found.force_n)).all()
    assert (found.sigma > 0).all() and found.area_mm2 > 0


def test_ways_of_markers_are_in_millimetres_along_both_axes():
    """Of a marker in the middle of a patch, which counts whole there."""
    at = GRID.pixel_from_gel(CENTERS[1, 2])[None]
    mean = marker_planes(at, np.array([[2.0, -3.0]]), SETTINGS, GRID)[:2, 1, 2]
    np.testing.assert_allclose(1.1 * MARKER_UNIT_MM * mean, [2.0 * 0.1, -3.0 * 0.12], rtol=1e-6)


def test_errors_hold_the_modulus_by_its_size_and_the_networks_own_by_their_factors():
    def read(share, factor=1.0):
        factors = tuple(factor * value for value in SETTINGS.sigma_factor)
        model = made_up(stiffness_relative=share, sigma_factor=factors)
        return model.read(picture(3), picture(4))

    own, wider = read(0.0), read(0.0, 2.0)
    np.testing.assert_allclose(wider.sigma, 2 * own.sigma, rtol=1e-6)
    loads = np.abs([*own.force_n, *own.moment_nmm])
    for share in (0.1, 0.2):
        np.testing.assert_allclose(
            read(share).sigma, np.hypot(own.sigma, [*(share * loads), 0.0]), rtol=1e-5
        )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.integers(0, 10))
def test_markers_come_in_any_order_and_some_are_missing(seed, count, lost):
    rng, model = np.random.default_rng(seed), made_up(markers=True)
    rest, moved = rng.uniform(0, 40, (count, 2)), rng.normal(0, 1, (count, 2))
    order = rng.permutation(count)
    more = rng.uniform(0, 40, (lost, 2)), np.full((lost, 2), np.nan)
    unseen = [np.concatenate(each) for each in zip((rest, moved), more, strict=True)]
    plain, none, *others = (
        marker_planes(*markers, model.config, GRID)
        for markers in ((rest, moved), (rest[:0], moved[:0]), (rest[order], moved[order]), unseen)
    )
    assert np.isfinite(none).all()
    for other in others:
        np.testing.assert_allclose(plain, other, atol=1e-6)
    images, orders = (picture(seed), picture(1)), (np.arange(count), order)
    by_markers = [model.read(*images, (rest[o], moved[o])).force_n for o in orders]
    np.testing.assert_allclose(*by_markers, rtol=1e-4, atol=1e-5)
    with pytest.raises(InputError, match="none were given"):
        model.read(*images)


@given(st.integers(1, 200), st.integers(1, 200))
def test_averaging_keeps_the_mean(count, wanted):
    matrix = area_matrix(count, wanted)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, rtol=1e-5)
    np.testing.assert_allclose(matrix.sum(axis=0), wanted / count, rtol=1e-4)


def test_bytes_are_halved_exactly():
    config = replace(SETTINGS, width_px=32, height_px=24)
    image = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    wanted = image.reshape(12, 2, 16, 2, 3).astype(np.float64).mean(axis=(1, 3))
    assert np.array_equal(reduced(image, config), wanted)
    assert np.array_equal(reduced(image[None], config)[0], wanted)


@given(st.floats(-5, 5), st.floats(-5, 5), st.integers(0, 2), st.integers(0, 3))
def test_moments_are_about_the_gels_origin(fx, fz, row, column):
    patches = torch.zeros(1, 3, 3, 4, dtype=torch.float64)
    patches[0, :, row, column] = torch.tensor([fx, 1.0, fz], dtype=torch.float64)
    found = moment_of(patches, torch.from_numpy(CENTERS))[0].numpy()
    arm = np.append(CENTERS[row, column], 0.0)
    np.testing.assert_allclose(found, np.cross(arm, [fx, 1.0, fz]), atol=1e-9)
    # The middle of the first of 4 x 3 patches of 10 x 10 px is pixel (4.5, 4.5).
    np.testing.assert_allclose(CENTERS[0, 0], [(4.5 - 18) * 0.1, (4.5 - 15) * 0.12])
    np.testing.assert_allclose(CENTERS[2, 3], [(34.5 - 18) * 0.1, (24.5 - 15) * 0.12])


@pytest.mark.parametrize(
    ("changes", "reasons"),
    [
        ({}, []),
        ({"distance_limits": (0.05, 50.0, 300.0)}, ["pattern"]),
        ({"distance_limits": (50.0, 0.05, 300.0)}, ["colours"]),
        ({"distance_limits": (50.0, 50.0, 0.05)}, ["reach of colours"]),
        ({"most": (400.0, 400.0, 0.1, 400.0)}, ["area"]),
        ({"most": (400.0, 400.0, 400.0, 0.1)}, ["force of a patch"]),
    ],
)
def test_what_lies_beyond_the_training_is_said(changes, reasons):
    near, found = (made_up(**each).read(picture(0), picture(1)) for each in ({}, changes))
    assert [said.split(":")[0] for said in found.outside] == reasons
    assert np.array_equal(found.force_n, near.force_n)


def test_colours_reach_as_far_as_their_farthest_place():
    levels = torch.zeros(1, 3, 12, 10)
    levels[0, :, 4:7, 2:5] = torch.tensor([30.0, -40.0, 0.0])[:, None, None]
    directions = color_directions()
    assert len(directions) == 26
    # Nothing changes beside it: ways against the change reach 0.
    wanted = np.maximum(directions @ [30.0, -40.0, 0.0], 0.0)
    np.testing.assert_allclose(color_reach(levels)[0].numpy(), wanted, atol=1e-4)


def test_blocks_without_the_newer_limits_are_read():
    model = made_up()
    values = model.config.to_dict()
    values["most"], values["distance_limits"] = values["most"][:3], values["distance_limits"][:2]
    config = ForceModelConfig.from_dict(values)
    assert config.most[3] == config.distance_limits[2] == math.inf
    weights = {name: value for name, value in model.weights.items() if name != "colors.most"}
    older = ForceModel(config, weights, GRID).read(picture(0), picture(1))
    assert not older.outside
    assert np.array_equal(older.force_n, model.read(picture(0), picture(1)).force_n)


VECTORS = arrays(np.float64, (2, 5, 3), elements=st.floats(-10, 10))


@given(VECTORS, VECTORS, arrays(np.float64, 3, elements=st.floats(-5, 5)))
def test_wrenches_are_about_the_origin(positions, forces, shift):
    here, there = (resultant_wrench(positions + by, forces) for by in (0.0, shift))
    assert np.allclose(here[:, :3], forces.sum(axis=1))
    assert np.allclose(here[:, 3:], np.cross(positions, forces).sum(axis=1))
    assert np.allclose(there[:, :3], here[:, :3])
    assert np.allclose(there[:, 3:], here[:, 3:] + np.cross(shift, here[:, :3]), atol=1e-9)


def test_bad_input_is_refused():
    with pytest.raises(InputError, match="needs"):
        made_up().read(picture(0)[:-1], picture(1))
    good, bad = np.zeros((2, 4, 3)), np.zeros((2, 4, 3))
    bad[1, 2, 0] = np.inf
    for positions, forces, message in (
        (good, np.zeros((2, 5, 3)), "forces has shape"),
        (good[0], good[0], r"\[env, node, 3\]"),
        (good, bad, r"\[1\]"),
    ):
        with pytest.raises(InputError, match=message):
            resultant_wrench(positions, forces)
