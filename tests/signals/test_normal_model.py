# SPDX-License-Identifier: Apache-2.0
"""Networks of normals and colours: their forward pass, and settings that are refused."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.networks.force_settings import ForceModelConfig
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import MAX_BANDS
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.force_model import ForceModel
from taccel_lab.signals.normal_features import (
    FeatureWindows,
    color_change,
    image_features,
    local_features,
    pixel_place,
)
from taccel_lab.signals.normal_model import RAYLEIGH_MEAN, NormalModel, relative_normals
from taccel_lab.signals.normals import rotate_from_z, rotate_to_z
from taccel_lab.signals.read_heights import read_heights

CONFIG = NormalModelConfig(48, 36, scales_px=(1.0, 3.0), slope_scales_px=(3.0,), members=3)


@pytest.fixture(autouse=True)
def one_thread():
    torch.set_num_threads(1)


def random_model(config: NormalModelConfig = CONFIG, seed: int = 0) -> NormalModel:
    rng = np.random.default_rng(seed)
    return NormalModel(
        config, {k: rng.normal(0, 0.3, shape) for k, shape in config.weight_shapes().items()}
    )


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


@given(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.integers(0, 99))
def test_rotation_from_z_is_one_and_is_undone(p, q, seed):
    rest = unit(np.array([p, q, 1.0]))
    assert rotate_from_z(np.array([0.0, 0.0, 1.0]), rest) == pytest.approx(rest)
    vector = np.random.default_rng(seed).normal(size=3)
    turned = rotate_from_z(vector, rest)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(vector))
    assert rotate_to_z(turned, rest) == pytest.approx(vector)


@given(st.floats(0, 1.4), st.floats(-3.2, 3.2))
def test_tilt_is_the_angle_of_the_normal(angle, direction):
    tilt = angle * np.array([np.cos(direction), np.sin(direction)])
    normal = relative_normals(tilt)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    assert np.arctan2(np.hypot(normal[0], normal[1]), normal[2]) == pytest.approx(angle, abs=1e-9)


def test_the_background_reads_as_rest_exactly():
    model = random_model()
    background = np.random.default_rng(1).uniform(0, 255, (36, 48, 3)).astype(np.float32)
    found = model.predict(background, background)
    assert np.array_equal(found.tilt_rad, np.zeros((36, 48, 2)))
    assert np.array_equal(found.slopes(), np.zeros((36, 48, 2)))
    assert (found.sigma_deg > 0).all()
    rest = unit(np.array([0.3, -0.2, 1.0])) * np.ones((36, 48, 1))
    curved = model.predict(background, background, rest_normals=rest)
    assert curved.normals == pytest.approx(rest)


def test_unchanged_pixels_read_as_rest_exactly_beside_a_press_and_masked_ones():
    model = random_model(WIDE)
    image, background = dented(6, 0.0)
    v, u = np.mgrid[:178, :241]
    far = np.hypot(u - 110.0, v - 70.0) > 45
    image[far] = background[far]
    mask = (np.abs(u - 200) > 5) | (np.abs(v - 150) > 5)
    found = model.predict(image, background, mask=mask)
    untouched = np.hypot(u - 110.0, v - 70.0) > 70
    assert (found.tilt_rad[untouched] == 0).all() and (found.tilt_rad != 0).any()


def by_pixels(model: NormalModel, image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Tilt and expected error of every pixel, read one by one, shape [h, w, 3]."""
    features = image_features(model.config, color_change(image, background), background)
    tilt, error = model.predict_pixels(features.reshape(-1, model.config.input_count))
    return np.column_stack([tilt, error]).reshape(*features.shape[:2], 3)


def test_every_second_row_and_column_reads_as_pixels_of_the_whole_image():
    grid = PixelGrid(47, 36, 0.05, 0.05)
    model = random_model(dataclasses.replace(CONFIG, width_px=47))
    rng = np.random.default_rng(3)
    background = rng.uniform(0, 255, (36, 47, 3)).astype(np.float32)
    v, u = np.mgrid[:36, :47]
    dent = 40.0 * np.exp(-((u - 23.0) ** 2 + (v - 18.0) ** 2) / 72.0)
    image = background + (dent[..., None] * [1.0, 0.5, -1.0]).astype(np.float32)
    mask = (v > 2) | (u > 5)
    rest = unit(np.array([0.3, -0.2, 1.0])) * np.ones((36, 47, 1))
    whole = read_heights(model, image, background, grid, mask=mask, rest_normals=rest)
    thin = read_heights(model, image, background, grid, mask=mask, rest_normals=rest, every=2)
    pixels = by_pixels(model, image, background)[::2, ::2]
    found = model.predict(image, background, every=2)
    np.testing.assert_allclose(found.tilt_rad, pixels[..., :2], atol=1e-5)
    np.testing.assert_allclose(
        np.radians(found.sigma_deg) * RAYLEIGH_MEAN, pixels[..., 2], rtol=1e-5
    )
    known = whole.rise_m[::2, ::2]
    off = (thin.rise_m - thin.rise_m.mean()) - (known - known.mean())
    assert np.abs(off).max() < 0.03 * np.ptp(known)


WIDE = dataclasses.replace(CONFIG, width_px=241, height_px=178)


def dented(seed: int, noise: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """An image with a dent whose rim is sharp and whose surroundings sink, and its background."""
    rng = np.random.default_rng(seed)
    background = rng.uniform(0, 255, (178, 241, 3)).astype(np.float32)
    v, u = np.mgrid[:178, :241]
    away = np.hypot(u - 110.0, v - 70.0)
    lean = np.where(away < 30, away / 30, np.exp(-(away - 30) / 8)) + 0.2 * np.exp(-away / 60)
    way = np.stack([u - 110.0, v - 70.0, 30.0 - away], axis=-1) / np.maximum(away, 1.0)[..., None]
    change = 60.0 * lean[..., None] * np.clip(way, -1, 1)
    change += rng.normal(0, noise, change.shape)
    return (background + change).astype(np.float32), background


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.3, 1.0])
def test_blocks_read_what_pixels_read(noise, monkeypatch):
    """Heights to 0.005 mm and their deviation to 2 %, by few answers of the networks."""
    model = random_model(dataclasses.replace(WIDE, height_factor=1.0, error_length_px=8.0))
    image, background = dented(4, noise)
    grid = PixelGrid(241, 178, 0.06, 0.06)
    asked = []
    features = FeatureWindows.features

    def counted(level, picked=None):
        found = features(level, picked)
        asked.append(found.shape[1])
        return found

    monkeypatch.setattr(FeatureWindows, "features", counted)
    model.predict(background, background)
    asked.clear()
    read = read_heights(model, image, background, grid)
    assert 0.06 < sum(asked) / image[..., 0].size < 0.4
    assert len(asked) == 3
    monkeypatch.setattr("taccel_lab.signals.block_reading.BEND", -1.0)
    monkeypatch.setattr("taccel_lab.signals.block_reading.MOST_NOISE", 1.0)
    pixels = read_heights(model, image, background, grid)
    assert sum(asked) > image[..., 0].size
    assert np.ptp(pixels.rise_m) > 0.2e-3
    assert np.abs(read.rise_m - pixels.rise_m).max() < 5e-6
    assert read.sigma_m is not None and pixels.sigma_m is not None
    assert read.sigma_m == pytest.approx(pixels.sigma_m, rel=0.02)


def test_fine_texture_and_masked_borders_are_read_by_pixels():
    model = random_model(WIDE)
    image, background = dented(5, 0.3)
    image[120:160, 180:220] += np.where(np.arange(40) % 4 < 2, 30.0, 0.0)[:, None, None]
    mask = np.ones((178, 241), dtype=bool)
    mask[20:50, 150:170] = False
    found = model.predict(image, background, mask=mask)
    features = image_features(
        model.config, color_change(image, background, mask), background, mask=mask
    )
    wanted = model.predict_pixels(features.reshape(-1, model.config.input_count))[0]
    off = np.linalg.norm(found.tilt_rad - wanted.reshape(178, 241, 2), axis=-1)
    beside = binary_dilation(~mask, iterations=2)
    texture = np.zeros_like(mask)
    texture[124:156, 184:216] = True
    for part in (beside & mask, texture):
        assert off[part].max() < np.radians(0.02)


def test_several_images_are_read_at_once():
    model = random_model(WIDE)
    pairs = [dented(seed) for seed in (1, 2)]
    background = pairs[0][1]
    images = np.stack([pairs[0][0], background, pairs[1][0] - pairs[1][1] + background])
    grid = PixelGrid(241, 178, 0.06, 0.06)
    together = read_heights(model, images, background, grid)
    for k, image in enumerate(images):
        alone = read_heights(model, image, background, grid)
        np.testing.assert_allclose(together.rise_m[k], alone.rise_m, atol=1e-8)
        np.testing.assert_allclose(together.normals.normals[k], alone.normals.normals, atol=1e-5)
    on_device = model.predict(torch.from_numpy(images), background)
    assert isinstance(on_device.normals, torch.Tensor)
    np.testing.assert_allclose(on_device.normals, together.normals.normals, atol=1e-6)


def test_poisoned_masked_pixels_have_no_effect():
    model = random_model()
    rng = np.random.default_rng(2)
    background = rng.uniform(0, 255, (36, 48, 3)).astype(np.float32)
    image = background + rng.normal(0, 20, background.shape).astype(np.float32)
    mask = np.ones((36, 48), dtype=bool)
    mask[10:20, 15:30] = False
    poisoned = image.copy()
    poisoned[~mask] = 1e4
    clean, dirty = (model.predict(i, background, mask=mask) for i in (image, poisoned))
    assert np.array_equal(clean.normals, dirty.normals)
    assert np.array_equal(clean.sigma_deg, dirty.sigma_deg)
    assert np.array_equal(clean.tilt_rad[~mask], np.zeros((int((~mask).sum()), 2)))
    assert not np.array_equal(model.predict(poisoned, background).normals, clean.normals)


def test_features_follow_a_zoomed_picture():
    """A pattern half as large, at scales half as wide, has the same features."""

    def picture(zoom, size):
        v, u = (np.mgrid[:size, :size] - (size - 1) / 2) * zoom
        return np.stack([40 * np.exp(-(u**2 + v**2) / 900), u, 0 * v], -1).astype(np.float32)

    def features(change, zoom):
        size = len(change)
        return local_features(change, (2.0, 6.0), (6.0,), place=pixel_place(size, size), zoom=zoom)[
            size // 2 + 0, size // 2, :-2
        ]

    large, small = features(picture(1.0, 161), 1.0), features(picture(2.0, 161), 0.5)
    assert small == pytest.approx(large, abs=0.02)
    assert np.abs(features(picture(2.0, 161), 1.0) - large).max() > 0.1


@pytest.mark.parametrize("name", ["cuda:77", "gpu"])
def test_devices_that_are_not_there_are_refused(name):
    with pytest.raises(InputError, match=f"device '{name}' is not here; devices of torch are cpu"):
        NormalModel(CONFIG, random_model().weights, name)


def test_wrong_shapes_are_refused():
    with pytest.raises(InputError, match="image has shape"):
        random_model().predict(np.zeros((36, 47, 3)), np.zeros((36, 48, 3)))


def test_features_of_single_pixels_are_those_of_the_picture():
    rng = np.random.default_rng(3)
    change, background = rng.normal(size=(2, 36, 48, 3)).astype(np.float32)
    config = NormalModelConfig(48, 36, background=True, position_bands=2)
    picked = rng.permutation(36 * 48)[:70]
    whole = image_features(config, change, background).reshape(-1, config.input_count)
    np.testing.assert_array_equal(
        image_features(config, change, background, picked=picked), whole[picked]
    )


SIZE = {"width_px": 40, "height_px": 30}
COLOR = ColorModelConfig(**SIZE, hidden=(16, 8))
NORMAL = NormalModelConfig(**SIZE, members=3, hidden=(16, 8))
FORCE = ForceModelConfig(**SIZE, columns=4, rows=3, patch_px=4, widths=(3, 5), blocks=2, hidden=6)
GRID = PixelGrid(40, 30, 0.1, 0.12)
Config = ColorModelConfig | NormalModelConfig | ForceModelConfig
Weights = dict[str, np.ndarray]


def weights_of(config: Config, seed: int = 0) -> Weights:
    shapes = config.weight_shapes()
    rng = np.random.default_rng(seed)
    return {n: rng.normal(0, s[-1] ** -0.5, s).astype(np.float32) for n, s in shapes.items()}


@pytest.mark.parametrize(
    "config",
    [
        COLOR,
        dataclasses.replace(COLOR, position_bands=3),
        NORMAL,
        NormalModelConfig(**SIZE, position_bands=2),
        NormalModelConfig(
            48, 36, members=2, hidden=(8,), input_mean=(1.0,) * 23, input_scale=(2.0,) * 23,
        ),
        FORCE,
    ],
)  # fmt: skip
def test_settings_go_through_a_dict_and_refuse_other_keys(config):
    kind, values = type(config), config.to_dict()
    assert kind.from_dict(values) == config
    with pytest.raises(InputError, match=r"unknown.*gamma"):
        kind.from_dict({**values, "gamma": 2})
    with pytest.raises(InputError, match="wrong type"):
        kind.from_dict({**values, "hidden": ["many"]})
    with pytest.raises(InputError, match=r"missing.*hidden"):
        kind.from_dict({name: value for name, value in values.items() if name != "hidden"})


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (COLOR, {"inputs": ("u", "shade")}, "inputs"),
        (COLOR, {"inputs": ()}, "inputs"),
        (COLOR, {"activation": "sine"}, "silu, tanh, relu"),
        (COLOR, {"hidden": (0,)}, "hidden"),
        (COLOR, {"width_px": 1}, "1x30 px"),
        (COLOR, {"input_mean": (0.0,)}, "input_mean needs 6"),
        (COLOR, {"input_mean": (math.nan,) * 6}, "input_mean of u must lie in"),
        (COLOR, {"input_scale": (0.0,) * 6}, r"input_scale of u must lie in \[0.0009, 2\]"),
        (COLOR, {"position_bands": -1}, r"color model position_bands must lie in \[0, 8\]"),
        (NORMAL, {"position_bands": MAX_BANDS + 1}, r"normal model position_bands must lie in"),
        (NORMAL, {"input_mean": (0.0,)}, "numbers, one per feature"),
        (NORMAL, {"members": 0}, "at least 1"),
        (FORCE, {"patch_px": 8}, "patch_px must be 4"),
        (FORCE, {"rows": 0}, "sizes"),
        (FORCE, {"widths": (3, 0)}, "widths"),
        (FORCE, {"most": (1.0, 2.0)}, "most needs 4"),
        (FORCE, {"sigma_factor": (0.0,) * 7}, "sigma_factor"),
        (FORCE, {"young_modulus_pa": 0.0}, "young_modulus_pa"),
        (FORCE, {"rows": 2000, "columns": 2000}, "patches"),
        # No gel is that large, that stiff or pressed that hard.
        (FORCE, {"target_scale": (1000.0, 1, 1, 1, 1, 1, 1)}, "force model.* target_scale"),
        (FORCE, {"target_scale": (1, 1, 1, 1, 1, 1, 1e5)}, "force model.* target_scale"),
        (FORCE, {"patch_scale_n": (1, 1, 1e-5)}, "force model.* patch_scale_n"),
        (FORCE, {"sigma_factor": (1, 1e3, 1, 1, 1, 1, 1)}, "force model.* sigma_factor"),
        (FORCE, {"most": (5e3, 1, 1, 1)}, "force model.* largest force"),
    ],
)
def test_settings_of_no_sensor_are_refused(config, changes, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(config, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "config", "name", "value", "message"),
    [
        (ColorModel, COLOR, "layer1.bias", None, "have shapes"),
        (ColorModel, COLOR, "layer1.bias", np.full(8, np.nan), "NaN"),
        (ColorModel, COLOR, "layer0.weight", np.zeros((16, 18)), "have shapes"),
        (NormalModel, NORMAL, "layer0.weight", np.zeros((1, 2)), "expected"),
        (ForceModel, FORCE, "down0.weight", np.zeros((3, 4, 3, 3)), "down0.weight"),
        (ForceModel, FORCE, "extra", np.zeros(2), "extra"),
        (ForceModel, FORCE, "hidden.bias", np.full(6, np.nan), "NaN"),
    ],
)
def test_weights_that_do_not_fit_are_refused(make, config, name, value, message):
    changed = weights_of(config) | {name: value}
    if value is None:
        del changed[name]
    with pytest.raises(InputError, match=message):
        make(config, changed, *([GRID] if make is ForceModel else []))


def test_a_tilt_is_less_sure_away_from_the_contacts_that_were_fitted():
    config = NormalModelConfig(200, 100, presses_px=(40.0, 50.0, 10.0, 60.0, 50.0, 20.0))
    away = config.away()
    assert away.shape == (100, 200)
    assert away[30:71, 30:81].max() == 0.0
    assert away[50, 110] == pytest.approx(0.3)
    assert away[90, 110] == pytest.approx(np.hypot(0.2, 0.3))
    assert np.array_equal(config.away(2), away[::2, ::2])
    assert NormalModelConfig(200, 100).away().max() == 0.0
    with pytest.raises(InputError, match="presses_px"):
        NormalModelConfig(200, 100, presses_px=(40.0, 50.0))
