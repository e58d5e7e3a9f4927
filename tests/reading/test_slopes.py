# SPDX-License-Identifier: Apache-2.0
"""The network of normals: rest is exact, blocks read what pixels read, its features."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.blocks import LARGEST_PX, finest_px, tilts_at_rest
from taccel_lab.reading.features import (
    LEVELS_PER_UNIT,
    Blocks,
    FeatureWindows,
    color_change,
    image_features,
    local_features,
    of_blocks,
    pixel_place,
)
from taccel_lab.reading.heights import read_heights
from taccel_lab.reading.reader import Reader
from taccel_lab.reading.slopes import NormalModel, relative_normals
from taccel_lab.signals.normals import rotate_from_z, rotate_to_z
from tests.networks.weights import random_weights
from tests.reading.dents import CONFIG, WIDE, WIDE_GRID, background, dented
from tools.bench.kept_reader import unit_of


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def random_model(config: NormalModelConfig = CONFIG) -> NormalModel:
    return NormalModel(config, random_weights(config, spread=0.3))


def by_pixels(model: NormalModel, image: np.ndarray, still: np.ndarray, mask=None) -> np.ndarray:
    """Tilt and expected error of every pixel, read one by one, shape [h, w, 3]."""
    change = color_change(image, still, mask)
    features = image_features(model.config, change, still, mask=mask)
    tilt, error = model.predict_pixels(features.reshape(-1, model.config.input_count))
    return np.column_stack([tilt, error]).reshape(*features.shape[:2], 3)


@given(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.integers(0, 99))
def test_rotation_from_z_is_one_and_is_undone(p, q, seed):
    rest = np.array([p, q, 1.0]) / np.linalg.norm([p, q, 1.0])
    assert rotate_from_z(np.array([0.0, 0.0, 1.0]), rest) == pytest.approx(rest)
    vector = np.random.default_rng(seed).normal(size=3)
    turned = rotate_from_z(vector, rest)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(vector))
    assert rotate_to_z(turned, rest) == pytest.approx(vector)


@given(st.floats(0, 1.4), st.floats(-3.2, 3.2))
def test_tilt_is_the_angle_of_the_normal(angle, direction):
    normal = relative_normals(angle * np.array([np.cos(direction), np.sin(direction)]))
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert np.arctan2(np.hypot(normal[0], normal[1]), normal[2]) == pytest.approx(angle, abs=1e-9)


def test_unchanged_pixels_read_as_rest_exactly():
    model, still = random_model(), background(1)
    found = model.predict(still, still)
    assert not found.tilt_rad.any() and not found.slopes().any()
    assert found.tilt_rad.shape == found.slopes().shape == (36, 48, 2)
    assert (found.sigma_deg > 0).all()
    rest = np.tile(np.array([0.3, -0.2, 1.0]) / np.sqrt(1.13), (36, 48, 1))
    assert model.predict(still, still, rest_normals=rest).normals == pytest.approx(rest)
    # Beside a press and masked ones as well.
    image, still = dented(6, 0.0)
    v, u = np.mgrid[:178, :241]
    away = np.hypot(u - 110.0, v - 70.0)
    image[away > 45] = still[away > 45]
    mask = (np.abs(u - 200) > 5) | (np.abs(v - 150) > 5)
    found = random_model(WIDE).predict(image, still, mask=mask)
    assert (found.tilt_rad[away > 80] == 0).all() and (found.tilt_rad != 0).any()


def test_a_coarse_look_shows_the_whole_surface_by_blocks():
    """Of curved gels and images that are no multiple of a block, too."""
    model, still = random_model(WIDE), background(3, 241, 178)
    v, u = np.mgrid[:178, :241]
    dent = 40.0 * np.exp(-((u - 110.0) ** 2 + (v - 90.0) ** 2) / 1200.0)
    image = still + (dent[..., None] * [1.0, 0.5, -1.0]).astype(np.float32)
    rest = np.tile(np.array([0.3, -0.2, 1.0]) / np.sqrt(1.13), (178, 241, 1))
    options = {"mask": (v > 2) | (u > 5), "rest_normals": rest}
    whole = read_heights(model, image, still, WIDE_GRID, **options)
    coarse = read_heights(model, image, still, WIDE_GRID, every=LARGEST_PX, **options)
    assert coarse.rise_m.shape == coarse.zero.shape == (23, 31)
    known = whole.rise_m[:176, :240].reshape(22, 8, 30, 8).mean(axis=(1, 3))
    off = coarse.rise_m[:22, :30] - known
    assert np.abs(off - off.mean()).max() < 0.03 * np.ptp(known)
    # Where nothing is to be seen closely, that is what the image reads as.
    nothing = read_heights(
        model, image, still, WIDE_GRID, around=np.zeros((23, 31), dtype=bool), **options
    )
    assert np.abs(nothing.rise_m - whole.rise_m).max() < 0.03 * np.ptp(known)


@pytest.mark.parametrize("size", [(178, 241), (160, 240)])
@pytest.mark.parametrize("masked", [False, True])
def test_windows_of_blocks_are_those_of_their_pixels(size: tuple[int, int], masked: bool):
    """Averages and variations to 0.01 levels of a picture as smooth as a lens shows, and exactly
    where a window takes pixels."""
    rng = np.random.default_rng(4)
    rough = rng.normal(0, 40, (*size, 3)).astype(np.float32)
    change = torch.from_numpy(gaussian_filter(rough, (2.5, 2.5, 0)))[None]
    mask = torch.ones(size, dtype=torch.bool)
    if masked:
        mask[40:60, 30:90] = False
    scales, slopes = (0.0, 0.7, 1.5, 3.1, 6.2), (1.5, 3.1, 6.2)
    windows = FeatureWindows(
        change, scales, slopes, lambda px: torch.zeros(0, *windows.count(px)), mask=mask
    )
    pixels = windows.blocks(1)
    for px in (2, 4, 8):
        blocks = windows.blocks(px)
        height, width = (count // px * px for count in size)
        part = pixels.changing[..., :height, :width].unflatten(-1, (-1, px)).unflatten(-3, (-1, px))
        known = part.mean(dim=(-3, -1))
        found = blocks.changing[..., : known.shape[-2], : known.shape[-1]]
        whole = mask[:height, :width].unflatten(-1, (-1, px)).unflatten(-3, (-1, px))
        counted = binary_erosion(whole.all(dim=3).all(dim=1).numpy(), iterations=2, border_value=1)
        off = (found - known)[..., torch.from_numpy(counted)].abs().amax(
            dim=(1, 2)
        ) * LEVELS_PER_UNIT
        assert off.max() < (0.25 if masked else 0.1), px
        part = windows.blocks(px, slice(3, 9), slice(2, 7))
        np.testing.assert_allclose(part.changing, blocks.changing[..., 3:9, 2:7], atol=1e-5)


def test_deviations_of_heights_hold_each_cause_by_its_size():
    """Twice the reading's own, errors along the slope, or the share of the depth of the calibration
    or of other units."""
    still = background(3)
    v, u = np.mgrid[:36, :48]
    dent = 40.0 * np.exp(-((u - 20.0) ** 2 / 60.0 + (v - 19.0) ** 2 / 100.0))
    image = still + (dent[..., None] * [1.0, 0.5, -1.0]).astype(np.float32)

    def read(reading=1.0, along=0.0, share=0.0, unit=0.0):
        factors = {"height_factor": reading, "along_factor": along, "depth_share": share}
        factors["unit_share"] = unit
        model = random_model(replace(CONFIG, error_length_px=4.0, **factors))
        return read_heights(model, image, still, PixelGrid(48, 36, 0.08, 0.05))

    alone, twice, leaning, steep = read(), read(reading=2.0), read(along=0.5), read(along=1.0)
    # At rest less, by one factor.
    quiet = alone.reading_sigma_m / alone.sigma_m
    assert np.ptp(quiet) < 1e-9 and 0.0 < quiet.max() <= 1.0
    np.testing.assert_allclose(twice.reading_sigma_m, 2 * alone.reading_sigma_m)
    grown = (found.sigma_m**2 - alone.sigma_m**2 for found in (leaning, steep))
    np.testing.assert_allclose(4 * next(grown), next(grown), atol=1e-18)
    for share in (0.05, 0.1):
        found, depth = read(along=0.5, share=share), np.abs(alone.rise_m)
        np.testing.assert_allclose(found.reading_sigma_m, alone.reading_sigma_m)
        wanted = np.hypot(leaning.sigma_m, share * depth)
        np.testing.assert_allclose(found.sigma_m, wanted, rtol=1e-9)
        np.testing.assert_allclose(read(along=0.5, unit=share).sigma_m, wanted, rtol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_blocks_read_what_pixels_read(noise, monkeypatch):
    """Heights to 0.005 mm and their deviation to 2 %, by few answers of the networks."""
    model = random_model(replace(WIDE, height_factor=1.0, error_length_px=8.0))
    image, still = dented(4, noise)
    asked, features = [], Blocks.features

    def counted(blocks, picked=None):
        found = features(blocks, picked)
        asked.append(found.shape[1])
        return found

    monkeypatch.setattr(Blocks, "features", counted)
    model.predict(still, still)
    asked.clear()
    read = read_heights(model, image, still, WIDE_GRID)
    assert 0.03 < sum(asked) / image[..., 0].size < 0.4
    assert len(asked) == 4
    monkeypatch.setattr("taccel_lab.reading.blocks.BEND", -1.0)
    monkeypatch.setattr("taccel_lab.reading.blocks.MOST_NOISE", 1.0)
    pixels = read_heights(model, image, still, WIDE_GRID)
    assert sum(asked) > image[..., 0].size
    assert np.ptp(pixels.rise_m) > 0.2e-3
    assert np.abs(read.rise_m - pixels.rise_m).max() < 5e-6
    assert read.sigma_m == pytest.approx(pixels.sigma_m, rel=0.02)


def test_small_pixels_are_read_two_by_two():
    """Where two are 0.08 mm at most: heights are those of single ones to 0.5 % of the deepest."""
    assert [finest_px(PixelGrid(9, 9, x, y)) for x, y in [(0.04, 0.04), (0.04, 0.05)]] == [2, 1]
    model = NormalModel(WIDE, random_weights(WIDE, spread=0.25))
    image, still = dented(4, 1.0)
    pixels, pairs = (read_heights(model, image, still, WIDE_GRID, every=k) for k in (1, 2))
    assert pairs.rise_m.shape == pairs.zero.shape == (89, 121)
    assert pairs.normals.normals.shape == (89, 121, 3)
    known = of_blocks(pixels.rise_m[:, :240], 2)
    off = np.abs(pairs.rise_m[:, :120] - known) / np.ptp(known)
    assert off.max() < 0.01 and off.mean() < 0.002


def test_fine_texture_and_masked_borders_are_read_by_pixels():
    model, (image, still) = random_model(WIDE), dented(5, 0.3)
    image[120:160, 180:220] += np.where(np.arange(40) % 4 < 2, 30.0, 0.0)[:, None, None]
    mask = np.ones((178, 241), dtype=bool)
    mask[20:50, 150:170] = False
    found = model.predict(image, still, mask=mask).tilt_rad
    off = np.linalg.norm(found - by_pixels(model, image, still, mask)[..., :2], axis=-1)
    beside = binary_dilation(~mask, iterations=2) & mask
    assert max(off[beside].max(), off[124:156, 184:216].max()) < np.radians(0.02)


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("masked", [False, True])
def test_images_read_alike_alone_and_among_others(threads: int, masked: bool):
    """To the bit, whatever was read before and however many threads there are."""
    torch.set_num_threads(threads)
    config = replace(WIDE, height_factor=1.0, error_length_px=8.0, depth_share=0.1)
    (first, still), (other, its) = dented(1), dented(2)
    images = np.stack([first, still, other - its + still])
    mask = np.random.default_rng(0).random(still.shape[:2]) > 0.02 if masked else None
    together = read_heights(random_model(config), images, still, WIDE_GRID, mask=mask)
    for k, image in enumerate(images):
        tilts_at_rest.cache_clear()
        alone = read_heights(random_model(config), image, still, WIDE_GRID, mask=mask)
        for name in ("slope", "rise_m", "zero", "sigma_m", "reading_sigma_m"):
            assert np.array_equal(getattr(together, name)[k], getattr(alone, name)), name
        assert np.array_equal(together.normals.normals[k], alone.normals.normals)


def test_few_pixels_read_as_among_many():
    """Products of few rows are added up in another order, which nobody may see."""
    model = random_model(WIDE)
    features = np.random.default_rng(0).normal(size=(700, WIDE.input_count))
    tilt, error = model.predict_pixels(features)
    few = model.predict_pixels(features[:3])
    assert np.array_equal(few[0], tilt[:3]) and np.array_equal(few[1], error[:3])


def test_several_images_are_read_at_once():
    model = random_model(WIDE)
    (first, still), (other, its) = dented(1), dented(2)
    images = np.stack([first, still, other - its + still])
    together = read_heights(model, images, still, WIDE_GRID)
    on_device = model.predict(torch.from_numpy(images), still)
    assert isinstance(on_device.normals, torch.Tensor)
    np.testing.assert_allclose(on_device.normals, together.normals.normals, atol=1e-6)


def test_poisoned_masked_pixels_have_no_effect():
    model, still = random_model(), background(2)
    image = still + np.random.default_rng(2).normal(0, 20, still.shape).astype(np.float32)
    mask = np.ones((36, 48), dtype=bool)
    mask[10:20, 15:30] = False
    poisoned = np.where(mask[..., None], image, np.float32(1e4))
    clean, dirty = (model.predict(i, still, mask=mask) for i in (image, poisoned))
    assert np.array_equal(clean.normals, dirty.normals)
    assert np.array_equal(clean.sigma_deg, dirty.sigma_deg)
    assert not clean.tilt_rad[~mask].any()
    assert not np.array_equal(model.predict(poisoned, still).normals, clean.normals)


def test_features_follow_a_zoomed_picture():
    """A pattern half as large, at scales half as wide, has the same features."""

    def features(shrunk, zoom):
        v, u = (np.mgrid[:161, :161] - 80) * shrunk
        change = np.stack([40 * np.exp(-(u**2 + v**2) / 900), u, 0 * v], -1).astype(np.float32)
        place = pixel_place(161, 161)
        return local_features(change, (2.0, 6.0), (6.0,), place=place, zoom=zoom)[80, 80, :-2]

    large = features(1.0, 1.0)
    assert features(2.0, 0.5) == pytest.approx(large, abs=0.02)
    assert np.abs(features(2.0, 1.0) - large).max() > 0.1


def test_features_of_single_pixels_are_those_of_the_picture():
    rng = np.random.default_rng(3)
    given_ = rng.normal(size=(2, 36, 48, 3)).astype(np.float32)
    config = NormalModelConfig(48, 36, background=True, position_bands=2)
    picked = rng.permutation(36 * 48)[:70]
    whole = image_features(config, *given_).reshape(-1, config.input_count)
    np.testing.assert_array_equal(image_features(config, *given_, picked=picked), whole[picked])


def test_an_image_of_a_single_block_is_too_small_to_be_read():
    grid = PixelGrid(12, 8, 1.0, 1.0)
    small = random_model(replace(CONFIG, width_px=12, height_px=8))
    with pytest.raises(InputError, match="has 12x8 px; slopes are read from images of more than 8"):
        Reader(unit_of(small, grid), background=background(0, 12, 8))


def test_devices_that_are_not_there_and_wrong_shapes_are_refused():
    for name in ("cuda:77", "gpu"):
        words = f"device '{name}' is not here; devices of torch are cpu"
        with pytest.raises(InputError, match=words):
            NormalModel(CONFIG, random_model().weights, name)
    with pytest.raises(InputError, match="image has shape"):
        random_model().predict(np.zeros((36, 47, 3)), np.zeros((36, 48, 3)))
