# SPDX-License-Identifier: Apache-2.0
"""Readings of fixed sizes: the same as those that follow the image, recorded or not."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.blocks import LARGEST_PX
from taccel_lab.reading.features import FeatureWindows, pixel_place, place_of_blocks
from taccel_lab.reading.fixed_network import FixedNetwork
from taccel_lab.reading.heights import ReadHeights, read_heights
from taccel_lab.reading.network_answers import network
from taccel_lab.reading.room import STEP, Room, require
from taccel_lab.reading.slope_integration import height_from_slopes
from taccel_lab.reading.slopes import NormalModel
from tests.networks.weights import random_weights
from tests.reading.dents import WIDE, WIDE_GRID, dented

MODEL = replace(
    WIDE, height_factor=1.0, error_length_px=8.0, depth_share=0.1, presses_px=(110.0, 70.0, 30.0)
)
needs_gpu = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device"),
]


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def model(device: str = "cpu") -> NormalModel:
    return NormalModel(MODEL, random_weights(MODEL, spread=0.3), device)


def images() -> tuple[np.ndarray, np.ndarray]:
    """A dented image, one of nothing, another dent; and the background."""
    (first, still), (other, its) = dented(1), dented(2)
    return np.stack([first, still, other - its + still]), still


def holes() -> np.ndarray:
    v, u = np.mgrid[:178, :241]
    return ((np.abs(u - 100) > 6) | (np.abs(v - 80) > 9)) & (u + v > 4)


UPPER = np.arange(23)[:, None] * np.ones(31) < 12
"""Blocks of the upper half."""
MIDDLE = np.pad(np.ones((12, 14), bool), ((3, 8), (6, 11)))
"""Blocks about a dent."""


def assert_alike(found: ReadHeights, known: ReadHeights) -> None:
    """To rounding, of slopes of 1 and of heights of some 1.5 mm."""
    for name, most in (("slope", 2e-5), ("rise_m", 1e-9), ("sigma_m", 2e-8), ("zero", 0.5)):
        values = torch.as_tensor(getattr(found, name)).double().cpu()
        np.testing.assert_allclose(values, getattr(known, name), rtol=0, atol=most)
    assert np.abs(np.asarray(known.rise_m)).max() > 5e-4


@pytest.mark.thorough
@pytest.mark.parametrize("masked", [False, True])
def test_fixed_sizes_read_what_sizes_of_each_image_do(masked: bool):
    """Also where the first images ask for less than later ones, and whatever there is room for."""
    (shown, still), mask = images(), holes() if masked else None
    known = read_heights(model(), shown, still, WIDE_GRID, mask=mask)
    reading, room = model(), Room()

    def read(given: np.ndarray) -> tuple[ReadHeights, bool]:
        with room.entered():
            found = read_heights(reading, torch.from_numpy(given), still, WIDE_GRID, mask=mask)
        return found, room.enough(room.asked().tolist())

    assert read(np.stack([still] * 3))[1]
    least = room.known("blocks of 1 px") or 0
    assert least == STEP or (masked and least)
    tries = [read(shown) for _ in range(12)]
    assert not tries[0][1] and tries[-1][1]
    assert (room.known("blocks of 1 px") or 0) > least
    found = tries[-1][0]
    assert_alike(found, known)
    # More room changes nothing.
    room.needs("blocks of 4 px", torch.tensor(0), 10**6, 30000)
    more, enough = read(shown)
    assert enough and torch.equal(more.rise_m, found.rise_m)
    assert np.array_equal(np.asarray(more.sigma_m), np.asarray(found.sigma_m))


def with_small(device: str = "cpu") -> NormalModel:
    """A model whose small network leaves half of all blocks to the ensemble."""
    config = replace(MODEL, small_hidden=(24, 24))
    weights = random_weights(config, spread=0.3)
    last = [name for name in weights if name.startswith("small.") and name.endswith("bias")][-1]
    weights[last] = weights[last] - np.array([0, 0, 0, 0.9], np.float32)
    return NormalModel(config, weights, device)


def test_a_room_reads_coarsely_as_often_as_it_is_asked():
    """Whatever was left to the ensemble before."""
    (shown, still), room = images(), Room()
    known = read_heights(with_small(), shown, still, WIDE_GRID, every=LARGEST_PX)
    for _ in range(3):
        with room.entered():
            given = torch.from_numpy(shown)
            found = read_heights(with_small(), given, still, WIDE_GRID, every=LARGEST_PX)
    assert_alike(found, known)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("block_px", [8, 2, 1])
def test_windows_of_picked_blocks_are_those_of_all(block_px: int, masked: bool):
    """Of images of bytes, as cameras give them."""
    rng = np.random.default_rng(3)
    seen = torch.from_numpy(rng.integers(0, 256, (2, 45, 62, 3), dtype=np.uint8))
    light = torch.from_numpy(rng.uniform(0, 255, (45, 62, 3)).astype(np.float32))
    mask = torch.ones((45, 62), dtype=torch.bool)
    mask[10:22, :30] = not masked
    scales, varied, place = (0.0, 0.7, 1.5, 6.2, 1.5), (1.5, 3.1, 9.0), pixel_place(62, 45, 1)
    maps = FeatureWindows(
        seen, scales, varied, lambda px: place_of_blocks(place, px), mask=mask, light=light
    )
    known = maps.blocks(block_px).features()
    picked = torch.arange(known.shape[1] + 5).flip(0)
    found = maps.sparse(block_px).features(picked)
    np.testing.assert_allclose(found.flip(1)[:, :-5], known, atol=3e-6)


@pytest.mark.parametrize("widths", [(41, 64, 64, 3), (5, 24, 4), (75, 33, 3)])
def test_a_kernel_takes_blocks_through_all_layers(widths: tuple[int, ...]):
    torch.manual_seed(1)
    layers = [
        (torch.randn(2, out, count) / count**0.5, torch.randn(2, out))
        for count, out in pairwise(widths)
    ]
    inputs = torch.randn(widths[0], 300)
    known = network(layers, inputs.T.expand(2, -1, -1))
    np.testing.assert_allclose(FixedNetwork(layers)(inputs), known, atol=3e-6)


def test_faults_of_input_are_kept_until_a_result_is_asked_for():
    """As at once, where sizes follow the image."""
    slope, grid, room = np.full((9, 9, 2), np.nan), PixelGrid(9, 9, 1.0, 1.0), Room()
    with pytest.raises(InputError, match="NaN"):
        height_from_slopes(slope, grid)
    with room.entered():
        height_from_slopes(slope, grid)
        require(torch.tensor([True]), lambda: "nothing")
    with pytest.raises(InputError, match="NaN"):
        room.enough(room.asked().tolist())


class TestOnGpu:
    pytestmark = needs_gpu

    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"mask": holes()},
            {"every": LARGEST_PX},
            {"every": 2},
            {"resting": UPPER},
            {"around": MIDDLE},
        ],
    )
    @pytest.mark.parametrize("made", [model, with_small])
    def test_a_recording_reads_what_a_cpu_does(self, made, options):
        shown, still = images()
        known = read_heights(made(), shown, still, WIDE_GRID, **options)
        reading = made("cuda:0")
        nothing = np.stack([still] * 3)
        before = read_heights(reading, nothing, still, WIDE_GRID, **options)
        assert np.abs(before.slope).max() < 1e-6
        assert_alike(read_heights(reading, shown, still, WIDE_GRID, **options), known)
        assert len(reading.recordings) == 1

    @pytest.mark.parametrize("small", [False, True])
    def test_a_recording_gives_the_bits_of_what_it_recorded(self, small):
        shown, still = images()
        reading = with_small("cuda:0") if small else model("cuda:0")
        given = torch.from_numpy(shown).cuda()
        found = read_heights(reading, given, torch.from_numpy(still).cuda(), WIDE_GRID)
        (recording,) = reading.recordings.values()
        again = recording.unrecorded([given, torch.from_numpy(still), *[None] * 4])
        assert found.rise_m.is_cuda and found.sigma_m is not None
        for name in ("slope", "rise_m", "zero", "sigma_m", "reading_sigma_m"):
            assert torch.equal(getattr(found, name), getattr(again, name)), name
        # Results stay when others are read.
        kept = found.rise_m.clone()
        read_heights(reading, given.flip(0), torch.from_numpy(still).cuda(), WIDE_GRID)
        assert torch.equal(kept, found.rise_m)

    def test_images_of_a_batch_read_as_alone(self):
        shown, still = images()
        reading = model("cuda:0")
        together = read_heights(reading, shown, still, WIDE_GRID)
        for k, image in enumerate(shown):
            alone = read_heights(reading, image, still, WIDE_GRID)
            np.testing.assert_allclose(together.rise_m[k], alone.rise_m, rtol=0, atol=1e-9)
            sigma = np.asarray(together.sigma_m)[k]
            np.testing.assert_allclose(sigma, np.asarray(alone.sigma_m), rtol=0, atol=2e-8)
