# SPDX-License-Identifier: Apache-2.0
"""Packed weights against the matrix units' rules, here carried out lane by lane in numpy."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.signals.color_fragments import NetworkLayout, pack_network
from taccel_lab.signals.color_kernel import color_kernel
from taccel_lab.signals.color_model import (
    INPUT_NAMES,
    ColorModel,
    ColorModelConfig,
    expected_shapes,
    pixel_uv,
)
from taccel_lab.signals.position_encoding import encode_position

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


def run(model: ColorModel, inputs: np.ndarray, pixel: np.ndarray | None = None) -> np.ndarray:
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
    total = 0.0
    for step, part in enumerate(a):
        at = layout.fragment_starts[-1] + (step * 32 + LANES) * 2
        total = total + multiply(part, packed.fragments[at[:, None] + [0, 1]])
    result = np.zeros((16, 8))
    for k in range(4):
        result[GROUP + 8 * (k // 2), 2 * THREAD + k % 2] = total[:, k]
    assert not result[:, 3:].any()
    return result[:, :3]


@pytest.mark.parametrize(
    ("hidden", "activation", "inputs", "bands"),
    [
        *[
            (hidden, activation, ("v", "normal_z", "normal_x", "displacement_mm"), 0)
            for hidden, activation in (
                ((64, 64, 64), "silu"),
                ((20, 40), "tanh"),
                ((5,), "silu"),
                ((48, 96), "silu"),
            )
        ],
        # With the table of places: of the positional encoding.
        ((20, 32), "silu", INPUT_NAMES, 3),
        ((20, 32), "tanh", INPUT_NAMES, 3),
    ],
)
def test_fragments_compute_the_network(hidden, activation, inputs, bands):
    config = ColorModelConfig(
        20,
        15,
        hidden=hidden,
        activation=activation,
        inputs=inputs,
        position_bands=bands,
        input_mean=(0.0,) * len(inputs),
        input_scale=(1.0,) * len(inputs),
    )
    rng = np.random.default_rng(1)
    weights = {
        name: rng.normal(0, 1.5 / np.sqrt(shape[-1]) if len(shape) == 2 else 0.3, shape)
        for name, shape in expected_shapes(config).items()
    }
    pixel = rng.integers(0, 20 * 15, 16) if bands else None
    given = rng.normal(0, 1, (16, 6))
    x = given[:, [INPUT_NAMES.index(name) for name in inputs]]
    if bands:
        given[:, :2] = x[:, :2] = uv = pixel_uv(config, pixel)
        x = np.concatenate([x, encode_position(uv, bands)], axis=1)
    for i in range(len(hidden)):
        x = x @ weights[f"layer{i}.weight"].T + weights[f"layer{i}.bias"]
        x = np.tanh(x) if activation == "tanh" else x / (1 + np.exp(-x))
    expected = x @ weights[f"layer{len(hidden)}.weight"].T * config.output_scale
    error = np.abs(run(ColorModel(config, weights), given, pixel) - expected)
    assert np.abs(expected).max() > 20
    assert error.max() < 0.12 and error.mean() < 0.03


def test_the_first_layer_keeps_more_than_half_precision():
    """Two inputs that differ by less than FP16 resolves still differ in the result."""
    config = ColorModelConfig(20, 15, hidden=(16,), activation="tanh", output_scale=1000.0)
    weights = {
        name: np.zeros(shape, dtype=np.float32) for name, shape in expected_shapes(config).items()
    }
    weights["layer0.weight"][0, :2] = 100.003, -100.003
    weights["layer1.weight"][0, 0] = 1.0
    inputs = np.zeros((16, 6))
    inputs[:, 0] = 1.0 + np.linspace(0, 2e-4, 16)
    inputs[:, 1] = 1.0
    expected = 1000 * np.tanh(weights["layer0.weight"][0, 0] * (inputs[:, 0] - inputs[:, 1]))
    assert np.unique(inputs[:, 0].astype(np.float16)).size == 1 and np.ptp(expected) > 15
    assert run(ColorModel(config, weights), inputs)[:, 0] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize(
    ("hidden", "activation", "encoded"),
    [
        ((64, 64, 64), "silu", False),
        ((20, 128), "tanh", False),
        ((16,), "relu", False),
        ((64, 64, 64), "silu", True),
    ],
)
def test_kernels_compile_for_hopper(hidden, activation, encoded, tmp_path):
    """The CUDA half of the source, which nothing else reads on a machine without a GPU."""
    module = color_kernel(hidden, activation, encoded=encoded).module
    wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path))
    assert list(tmp_path.glob("*.sm90.cubin"))
    (source,) = (path.read_text() for path in tmp_path.glob("*.cu"))
    assert source.count("mma.sync.aligned.m16n8k16") == 1
    assert ("place.data + 64 * (width + at / width)" in source) == encoded
