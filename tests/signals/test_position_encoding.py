# SPDX-License-Identifier: Apache-2.0
"""Positional encoding and packed weights: the same answer from every evaluator of the networks."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.color_settings import INPUT_NAMES, ColorModelConfig, pixel_uv
from taccel_lab.networks.normal_settings import NormalModelConfig, feature_names
from taccel_lab.networks.settings import MAX_BANDS, band_names, encode_position
from taccel_lab.reading.features import pixel_place
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_kernel import NetworkLayout, color_kernel, pack_network
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.tactile_image import DeviceColorModel
from tests.networks.weights import random_weights
from tests.signals.host_colors import host_image
from tests.signals.tactile_cases import DEVICES, LEVELS, color_model

WIDTH, HEIGHT = 30, 22
GRID = PixelGrid(WIDTH, HEIGHT, 0.1, 0.1)


@given(st.floats(-1, 1), st.floats(-1, 1), st.integers(0, MAX_BANDS))
def test_features_are_those_of_the_formula(u, v, bands):
    values = encode_position(np.array([u, v]), bands).tolist()
    found = dict(zip(band_names(bands), values, strict=True))
    assert len(found) == 4 * bands
    for k in range(bands):
        for axis, place in (("u", u), ("v", v)):
            assert found[f"sin_{axis}_{k}"] == pytest.approx(np.sin(2**k * np.pi * place))
            assert found[f"cos_{axis}_{k}"] == pytest.approx(np.cos(2**k * np.pi * place))


def test_the_network_gets_them_after_its_inputs_unscaled():
    model = color_model(GRID, hidden=(5,), bands=2, spread=1.2)
    assert model.weights["layer0.weight"].shape == (5, 6 + 8)
    idx, normal, depth = np.array([WIDTH + 4]), np.array([[0.3, -0.2, 0.9]]), np.array([-0.3])
    u, v = 2 * 4 / (WIDTH - 1) - 1, 2 * 1 / (HEIGHT - 1) - 1
    waves = [wave(f * at) for f in (np.pi, 2 * np.pi) for wave in (np.sin, np.cos) for at in (u, v)]

    def network(n, d):
        raw = np.array([u, v, *n, d]) - model.config.input_mean
        x = np.array([*(raw / model.config.input_scale), *waves])
        x = model.weights["layer0.weight"] @ x + model.weights["layer0.bias"]
        return 32 * model.weights["layer1.weight"] @ (x / (1 + np.exp(-x)))

    expected = network([0.3, -0.2, 0.9], -0.3) - network([0.0, 0.0, 1.0], 0.0)
    found = model.predict_pixels(idx, normal, depth, np.array([[0.0, 0.0, 1.0]]))
    assert found[0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("bands", [0, 1, 4])
def test_device_images_are_those_of_the_model(bands, device):
    model = color_model(GRID, (20, 16), bands, spread=1.2)
    rng = np.random.default_rng(1)
    rest = rng.normal(0, 0.05, (HEIGHT, WIDTH, 3)) * [1, 1, 0]
    samples = rest + rng.normal(0, 1, (2, HEIGHT, WIDTH, 3)) * [0.3, 0.3, 2e-4]
    samples[0, :5] = rest[:5]
    still = rng.uniform(60, 190, (HEIGHT, WIDTH, 3)).astype(np.float32)
    given_ = [
        wp.array(slopes.astype(np.float32), dtype=wp.vec3f, device=device)
        for slopes in (rest, samples)
    ]
    levels = wp.empty((2, HEIGHT, WIDTH, 3), dtype=wp.float32, device=device)
    DeviceColorModel(model, still, given_[0]).render(given_[1], None, levels)
    normals, at_rest = normals_from_slopes(samples[..., :2]), normals_from_slopes(rest[..., :2])
    depth_mm = 1e3 * (samples[..., 2] - rest[..., 2])
    expected = np.stack(
        [host_image(model, still, normals[i], depth_mm[i], at_rest) for i in (0, 1)]
    )
    assert np.abs(expected - still).max() > 10
    assert np.abs(levels.numpy() - expected).max() < LEVELS[device]
    assert np.array_equal(levels.numpy()[0, :5], still[:5])


def test_the_normals_network_has_them_among_its_features():
    bands = ("sin_u_0", "sin_v_0", "cos_u_0", "cos_v_0")
    plain = feature_names((1.0,), (2.0,), True)
    assert feature_names((1.0,), (2.0,), True, 1) == (*plain, *bands)
    place = pixel_place(WIDTH, HEIGHT, 2)
    assert place.shape == (HEIGHT, WIDTH, 10) and place.dtype == np.float32
    assert place[3, 7, 2:] == pytest.approx(encode_position(place[3, 7, :2], 2), abs=1e-6)
    config = NormalModelConfig(WIDTH, HEIGHT, position_bands=2, members=2, hidden=(8,))
    weights = random_weights(config, spread=0.3)
    still = np.full((HEIGHT, WIDTH, 3), 100.0)
    image = still + np.random.default_rng(0).normal(0, 20, still.shape)
    model = NormalModel(config, weights)
    # Unchanged gel is at rest, and a band's weights have an effect elsewhere.
    assert not model.predict(still, still).tilt_rad.any()
    first = weights["layer0.weight"].copy()
    first[..., -8:] = 0.0
    without = NormalModel(config, {**weights, "layer0.weight": first})
    tilts = [each.predict(image, still).tilt_rad for each in (model, without)]
    assert np.abs(tilts[1] - tilts[0]).max() > 1e-2


LANES = np.arange(32)
GROUP, THREAD = LANES // 4, LANES % 4


def halves(words: np.ndarray) -> np.ndarray:
    """The two FP16 numbers of each 32-bit word, low one first, shape [..., 2]."""
    return np.ascontiguousarray(words).view(np.float16).reshape(*words.shape, 2).astype(np.float64)


def words(pairs: np.ndarray) -> np.ndarray:
    """Inverse of ``halves``."""
    return np.ascontiguousarray(pairs.astype(np.float16)).view(np.uint32)[..., 0]


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``mma.m16n8k16`` (PTX ISA) of registers a [32, 4] and b [32, 2]: accumulators [32, 4]."""
    left, right = np.full((16, 16), np.nan), np.full((16, 8), np.nan)
    for register in range(4):
        for part in range(2):
            row = GROUP + 8 * (register % 2)
            left[row, 2 * THREAD + part + 8 * (register // 2)] = halves(a[:, register])[:, part]
    for register in range(2):
        for part in range(2):
            right[2 * THREAD + part + 8 * register, GROUP] = halves(b[:, register])[:, part]
    product = left @ right
    return np.stack([product[GROUP + 8 * (k // 2), 2 * THREAD + k % 2] for k in range(4)], axis=-1)


def run_fragments(
    model: ColorModel, inputs: np.ndarray, pixel: np.ndarray | None = None
) -> np.ndarray:
    """Output before the anchor for 16 pixels of normalised inputs [16, 6], from the fragments.

    ``pixel`` are their places along rows [16], with a positional encoding."""
    packed, layout = pack_network(model), NetworkLayout.of(model.config.hidden)
    columns = model.config.width_px
    half = 0.5 if model.config.activation == "silu" else 1.0
    activation = {"silu": lambda h: h + h * np.tanh(h), "tanh": np.tanh}[model.config.activation]
    high = inputs.astype(np.float16).astype(np.float64)
    features = [np.pad(part, ((0, 0), (0, 2))) for part in (high, inputs - high)]
    registers = [
        words(features[k // 2][(GROUP + 8 * (k % 2))[:, None], 2 * THREAD[:, None] + [0, 1]])
        for k in range(4)
    ]
    a = [np.stack(registers, axis=-1)]
    for layer, width in enumerate(layout.padded):
        start, following = layout.fragment_starts[layer], []
        for tile in range(width // 8):
            bias_at = layout.bias_starts[layer] + 8 * tile + 2 * THREAD
            bias = packed.biases[bias_at[:, None] + [0, 1, 0, 1]]
            if layer == 0 and pixel is not None:
                # Row g or g + 8 of each accumulator, as the kernel reads its pixel's table rows.
                at = pixel[GROUP[:, None] + [0, 0, 8, 8]]
                column = 8 * tile + 2 * THREAD[:, None] + [0, 1, 0, 1]
                bias = bias + half * packed.place[at % columns, column]
                bias = bias + half * packed.place[columns + at // columns, column]
            if layer == 0:
                at = start + (tile // 2 * 32 + LANES) * 4 + 2 * (tile % 2)
                whole, rest = packed.fragments[at], packed.fragments[at + 1]
                total = multiply(a[0], np.stack([whole, whole], axis=-1))
                upper = a[0].copy()
                upper[:, 2:] = 0
                total += multiply(upper, np.stack([rest, np.zeros_like(rest)], axis=-1))
            else:
                total = 0.0
                for step, part in enumerate(a):
                    at = start + ((tile // 2 * len(a) + step) * 32 + LANES) * 4 + 2 * (tile % 2)
                    total = total + multiply(part, packed.fragments[at[:, None] + [0, 1]])
            following.append(activation(total + bias))
        # Accumulators of two tiles are the next operand's registers.
        a = [
            np.stack([words(tile[:, k : k + 2]) for tile in pair for k in (0, 2)], axis=-1)
            for pair in zip(following[::2], following[1::2], strict=True)
        ]
    total = np.zeros((32, 4))
    for step, part in enumerate(a):
        at = layout.fragment_starts[-1] + (step * 32 + LANES) * 2
        total += multiply(part, packed.fragments[at[:, None] + [0, 1]])
    result = np.zeros((16, 8))
    for k in range(4):
        result[GROUP + 8 * (k // 2), 2 * THREAD + k % 2] = total[:, k]
    assert not result[:, 3:].any()
    return result[:, :3]


FEW = ("v", "normal_z", "normal_x", "displacement_mm")


@pytest.mark.parametrize(
    ("hidden", "activation", "inputs", "bands"),
    [
        ((64, 64, 64), "silu", FEW, 0),
        ((20, 40), "tanh", FEW, 0),
        ((5,), "silu", FEW, 0),
        ((48, 96), "silu", FEW, 0),
        # With the table of places: of the positional encoding.
        ((20, 32), "silu", INPUT_NAMES, 3),
        ((20, 32), "tanh", INPUT_NAMES, 3),
    ],
)
def test_fragments_compute_the_network(hidden, activation, inputs, bands):
    config = ColorModelConfig(
        20, 15, hidden=hidden, activation=activation, inputs=inputs, position_bands=bands,
        input_mean=(0.0,) * len(inputs), input_scale=(1.0,) * len(inputs),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    weights = {
        name: rng.normal(0, 1.5 / np.sqrt(shape[-1]) if len(shape) == 2 else 0.3, shape)
        for name, shape in config.weight_shapes().items()
    }
    pixel = rng.integers(0, 20 * 15, 16) if bands else None
    given_ = rng.normal(0, 1, (16, 6))
    x = given_[:, [INPUT_NAMES.index(name) for name in inputs]]
    if bands:
        given_[:, :2] = x[:, :2] = uv = pixel_uv(config, pixel)
        x = np.concatenate([x, encode_position(uv, bands)], axis=1)
    for i in range(len(hidden)):
        x = x @ weights[f"layer{i}.weight"].T + weights[f"layer{i}.bias"]
        x = np.tanh(x) if activation == "tanh" else x / (1 + np.exp(-x))
    expected = x @ weights[f"layer{len(hidden)}.weight"].T * config.output_scale
    error = np.abs(run_fragments(ColorModel(config, weights), given_, pixel) - expected)
    assert np.abs(expected).max() > 20
    assert error.max() < 0.12 and error.mean() < 0.03


def test_the_first_layer_keeps_more_than_half_precision():
    """Two inputs that differ by less than FP16 resolves still differ in the result."""
    config = ColorModelConfig(20, 15, hidden=(16,), activation="tanh", output_scale=1000.0)
    weights = {name: np.zeros(shape, np.float32) for name, shape in config.weight_shapes().items()}
    weights["layer0.weight"][0, :2] = 100.003, -100.003
    weights["layer1.weight"][0, 0] = 1.0
    inputs = np.zeros((16, 6))
    inputs[:, 0] = 1.0 + np.linspace(0, 2e-4, 16)
    inputs[:, 1] = 1.0
    expected = 1000 * np.tanh(weights["layer0.weight"][0, 0] * (inputs[:, 0] - inputs[:, 1]))
    assert np.unique(inputs[:, 0].astype(np.float16)).size == 1 and np.ptp(expected) > 15
    found = run_fragments(ColorModel(config, weights), inputs)[:, 0]
    assert found == pytest.approx(expected, abs=0.03)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("hidden", "activation", "encoded"),
    [((20, 128), "tanh", False), ((64, 64, 64), "silu", True)],
)
def test_kernels_compile_for_hopper(hidden, activation, encoded, tmp_path):
    """The CUDA half of the source, which nothing else reads on a machine without a GPU."""
    module = color_kernel(hidden, activation, encoded=encoded).module
    wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path))
    assert list(tmp_path.glob("*.sm90.cubin"))
    (source,) = (path.read_text() for path in tmp_path.glob("*.cu"))
    assert source.count("mma.sync.aligned.m16n8k16") == 1
    assert ("place.data + 64 * (width + at / width)" in source) == encoded
