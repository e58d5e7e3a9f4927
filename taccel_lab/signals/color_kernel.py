# SPDX-License-Identifier: Apache-2.0
"""The device kernel of a colour model: the whole network in registers, one launch an image batch.

On CUDA a warp renders 32 pixels. It exchanges their inputs, runs them through the layers with
``mma.sync`` (see below), and each lane finishes its own pixel; activations never
leave the registers, which is what makes the network cheaper than writing them (the idea of T.
Mueller et al., "Real-time neural radiance caching for path tracing", ACM TOG 40 (2021), there with
shared memory). A warp without a moved pixel copies the background. Elsewhere (the CPU) a thread
runs one pixel in FP32.

The source is generated: loop bounds and layer offsets are constants of the architecture. With a
positional encoding the first layer starts from tabulated sums of the pixel's column and row.

Weights of a colour model in the order in which a GPU's matrix units take them.

A warp holds the activations of 16 pixels as the 16x16 operand A of ``mma.sync.m16n8k16``, and the
weights are its 16x8 operand B: lane ``4 g + t`` holds the rows 2t, 2t + 1, 2t + 8 and 2t + 9 of
column g (PTX ISA, "Matrix fragments for mma.m16n8k16"). Accumulators of two neighbouring column
tiles have the layout of A, so a layer's output is the next layer's input without a shuffle. Weights
are stored lane by lane and read as whole 16-byte words.

The first layer takes the inputs as two halves each, ``x = hi + lo``, and so its weights, which
leaves errors of 2^-22: positions and normals are too finely graded for one FP16 number. The hidden
layers have FP16 weights and activations with FP32 sums.

A positional encoding is a sum of a function of the column and one of the row, so what it adds to
the first layer is tabulated once for each column and each row; the layer starts from there.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor native functions.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.networks.color_settings import INPUT_NAMES
from taccel_lab.networks.settings import encode_position
from taccel_lab.signals.color_model import ColorModel

TILE = 16
"""Widths of hidden layers are padded to multiples of this."""
WIDEST = 128
"""Widest hidden layer whose activations fit a warp's registers."""
_FEATURES = 8
_LANES = 32


@dataclass(frozen=True)
class NetworkLayout:
    """Where the parts of a network begin in its packed arrays."""

    padded: tuple[int, ...]
    """Widths of the hidden layers, padded."""
    fragment_starts: tuple[int, ...]
    """First 32-bit word of each layer in ``fragments``, the output layer last."""
    bias_starts: tuple[int, ...]
    """First entry of each hidden layer in ``biases``."""
    fragment_count: int
    bias_count: int

    @classmethod
    def of(cls, hidden: tuple[int, ...]) -> NetworkLayout:
        """Layout of a network with these hidden widths."""
        padded = tuple(-(-width // TILE) * TILE for width in hidden)
        # Per pair of column tiles and lane: (hi, lo) of both for the first layer, then two
        # registers of both tiles per 16 inputs; the output layer is one tile.
        words = [padded[0] // 16 * _LANES * 4]
        words += [
            padded[i] // 16 * (padded[i - 1] // 16) * _LANES * 4 for i in range(1, len(padded))
        ]
        words.append(padded[-1] // 16 * _LANES * 2)
        return cls(
            padded=padded,
            fragment_starts=tuple(int(n) for n in np.cumsum([0, *words[:-1]])),
            bias_starts=tuple(int(n) for n in np.cumsum([0, *padded[:-1]])),
            fragment_count=sum(words),
            bias_count=sum(padded),
        )


@dataclass(frozen=True)
class PackedNetwork:
    """A colour model's numbers as the device kernels read them."""

    fragments: np.ndarray
    """FP16 pairs for the matrix units, uint32, see ``NetworkLayout``."""
    biases: np.ndarray
    """Biases of the hidden layers, padded, float32, scaled like the fragments."""
    plain: np.ndarray
    """Parameters for other devices: bias [out] and weights [in, out] of each layer in turn,
    float32."""
    normalization: np.ndarray
    """Numbers as ``normalization`` says, float32, shape [15]."""
    place: np.ndarray
    """Sums as ``place_sums`` says; empty without a positional encoding."""


def canonical_weights(model: ColorModel) -> list[np.ndarray]:
    """Weights of each layer, float64; the first takes all of ``INPUT_NAMES`` in their order, and
    nothing of a positional encoding."""
    config = model.config
    weights = [
        model.weights[f"layer{i}.weight"].astype(np.float64)
        for i in range(len(config.layer_sizes()))
    ]
    first = np.zeros((len(weights[0]), len(INPUT_NAMES)))
    for column, name in enumerate(config.inputs):
        first[:, INPUT_NAMES.index(name)] = weights[0][:, column]
    weights[0] = first
    weights[-1] = weights[-1] * config.output_scale
    return weights


def normalization(model: ColorModel) -> np.ndarray:
    """Mean of each of ``INPUT_NAMES``, one over its scale (zero and one for those not used), the
    steps of u and v from pixel to pixel, and the slope of the cone that normals are kept within."""
    config = model.config
    mean, scale = np.zeros(len(INPUT_NAMES)), np.ones(len(INPUT_NAMES))
    for name, value, width in zip(
        config.inputs, config.input_mean, config.input_scale, strict=True
    ):
        mean[INPUT_NAMES.index(name)] = value
        scale[INPUT_NAMES.index(name)] = width
    steps = [2.0 / (config.width_px - 1), 2.0 / (config.height_px - 1)]
    steepest = math.tan(math.radians(model.cone_deg))
    return np.concatenate([mean, 1.0 / scale, steps, [steepest]]).astype(np.float32)


def place_sums(model: ColorModel) -> np.ndarray:
    """What the positional encoding adds to the first layer's outputs [padded]: one row a column of
    the image, then one row a row of it, float32, shape [width_px + height_px, padded]."""
    config = model.config
    padded = NetworkLayout.of(config.hidden).padded[0]
    if not config.position_bands:
        return np.empty((0, padded), dtype=np.float32)
    weight = model.weights["layer0.weight"][:, len(config.inputs) :].astype(np.float64)
    parts = []
    for axis, size in enumerate((config.width_px, config.height_px)):
        uv = np.zeros((size, 2))
        uv[:, axis] = np.linspace(-1, 1, size)
        # Columns 0, 2, ... are of u and 1, 3, ... of v.
        own = slice(axis, None, 2)
        sums = encode_position(uv, config.position_bands)[:, own] @ weight[:, own].T
        parts.append(np.pad(sums, ((0, 0), (0, padded - sums.shape[1]))))
    return np.concatenate(parts).astype(np.float32)


def pack_network(model: ColorModel) -> PackedNetwork:
    """Pack a colour model; the bias of the last layer cancels in the change and is left out."""
    config = model.config
    layout = NetworkLayout.of(config.hidden)
    weights = canonical_weights(model)
    biases = [model.weights[f"layer{i}.bias"].astype(np.float64) for i in range(len(config.hidden))]
    plain = [
        part.ravel()
        for i, weight in enumerate(weights)
        for part in (biases[i] if i < len(biases) else np.zeros(3), weight.T)
    ]
    # silu(x) = h + h tanh(h) with h = x / 2, which costs one special function.
    half = 0.5 if config.activation == "silu" else 1.0
    fragments = np.zeros(layout.fragment_count, dtype=np.uint32)
    packed_biases = np.zeros(layout.bias_count, dtype=np.float32)
    for i, weight in enumerate(weights):
        last = i == len(weights) - 1
        outputs = 8 if last else layout.padded[i]
        inputs = _FEATURES if i == 0 else layout.padded[i - 1]
        padded = np.zeros((outputs, inputs))
        padded[: weight.shape[0], : weight.shape[1]] = weight if last else weight * half
        words = _first_fragments(padded) if i == 0 else _fragments(padded)
        start = layout.fragment_starts[i]
        fragments[start : start + words.size] = words.ravel()
        if not last:
            begin = layout.bias_starts[i]
            packed_biases[begin : begin + len(biases[i])] = biases[i] * half
    return PackedNetwork(
        fragments=fragments,
        biases=packed_biases,
        plain=np.concatenate(plain).astype(np.float32),
        normalization=normalization(model),
        place=place_sums(model),
    )


def _pair(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Two FP16 numbers in one 32-bit word."""
    low_bits = low.astype(np.float16).view(np.uint16).astype(np.uint32)
    high_bits = high.astype(np.float16).view(np.uint16).astype(np.uint32)
    return low_bits | (high_bits << np.uint32(16))


def _first_fragments(weight: np.ndarray) -> np.ndarray:
    """Words [column tile pair, lane, (hi, lo) of each tile] of the first layer."""
    high = weight.astype(np.float16).astype(np.float64)
    lane = np.arange(_LANES)
    column, row = lane // 4, 2 * (lane % 4)
    tiles = []
    for tile in range(len(weight) // 8):
        output = 8 * tile + column
        words = [_pair(part[output, row], part[output, row + 1]) for part in (high, weight - high)]
        tiles.append(np.stack(words, axis=-1))
    pairs = np.stack(tiles).reshape(-1, 2, _LANES, 2)
    return pairs.transpose(0, 2, 1, 3)


def _fragments(weight: np.ndarray) -> np.ndarray:
    """Words [column tile pair, 16 inputs, lane, two of each tile]; one tile: [inputs, lane, 2]."""
    lane = np.arange(_LANES)
    column, row = lane // 4, 2 * (lane % 4)
    tiles = []
    for tile in range(len(weight) // 8):
        output = 8 * tile + column
        steps = []
        for step in range(weight.shape[1] // 16):
            words = []
            for part in (0, 8):
                k = 16 * step + part + row
                words.append(_pair(weight[output, k], weight[output, k + 1]))
            steps.append(np.stack(words, axis=-1))
        tiles.append(np.stack(steps))
    stacked = np.stack(tiles)
    if len(stacked) == 1:
        return stacked[0]
    pairs = stacked.reshape(-1, 2, *stacked.shape[1:])
    return pairs.transpose(0, 2, 3, 1, 4)


wp.set_module_options({"enable_backward": False})

vec15f = wp.types.vector(length=15, dtype=wp.float32)

WRITE_BYTES = 1
"""Rounded levels into ``image``."""
WRITE_LEVELS = 2
"""Unrounded levels into ``levels``."""
WRITE_OUTPUT = 4
"""The network's own output instead of the change, into ``levels``."""

_PIXEL = native("color_kernel", "pixel")

_FINISH = native("color_kernel", "finish")


def _activation(name: str, cuda: bool) -> str:
    """Body of ``float act(float x)``; on CUDA of x/2 for silu, as the weights are halved."""
    if name == "relu":
        return "return x > 0.0f ? x : 0.0f;"
    if cuda:
        tanh = 'float y; asm("tanh.approx.f32 %0, %1;" : "=f"(y) : "f"(x));'
        return f"{tanh} return {'y' if name == 'tanh' else 'x * y + x'};"
    return "return tanhf(x);" if name == "tanh" else "return x / (1.0f + expf(-x));"


def _host_source(hidden: tuple[int, ...], activation: str, encoded: bool) -> str:
    """One pixel, layer by layer, in FP32."""
    stride = NetworkLayout.of(hidden).padded[0]
    widest = max(*hidden, 8)
    source = [
        f"auto act = [](float x) {{ {_activation(activation, cuda=False)} }};",
        f"float a[{widest}], b[{widest}];",
        "for (int k = 0; k < 6; ++k) a[k] = x[k];",
        "const float* w = plain.data;",
        "if (moved) {",
    ]
    inputs = 6
    for layer, outputs in enumerate((*hidden, 3)):
        source += [
            f"for (int o = 0; o < {outputs}; ++o) b[o] = w[o];",
            *([_filled(_HOST_PLACE, OUT=outputs, STRIDE=stride)] if encoded and layer == 0 else []),
            f"w += {outputs};",
            f"for (int k = 0; k < {inputs}; ++k)",
            f"    for (int o = 0; o < {outputs}; ++o) b[o] += a[k] * w[k * {outputs} + o];",
            f"w += {inputs * outputs};",
        ]
        if layer < len(hidden):
            source.append(f"for (int o = 0; o < {outputs}; ++o) a[o] = act(b[o]);")
        inputs = outputs
    source += ["for (int c = 0; c < 3; ++c) out[c] = b[c];", "}"]
    return "\n    ".join(source)


_HOST_PLACE = native("color_kernel", "host_place")

_CUDA_BEGIN = native("color_kernel", "cuda_begin")

_CUDA_ACCUMULATORS = native("color_kernel", "cuda_accumulators")

_CUDA_PLACE = native("color_kernel", "cuda_place")

_CUDA_PLACE_SUMS = native("color_kernel", "cuda_place_sums")

_CUDA_ACTIVATE = native("color_kernel", "cuda_activate")

_CUDA_FIRST = native("color_kernel", "cuda_first")

_CUDA_HIDDEN = native("color_kernel", "cuda_hidden")

_CUDA_END = native("color_kernel", "cuda_end")


def _filled(text: str, **values: Any) -> str:
    for name, value in values.items():
        text = text.replace(f"@{name}@", str(value))
    return text


def _cuda_source(hidden: tuple[int, ...], activation: str, encoded: bool) -> str:
    """32 pixels a warp through the matrix units."""
    layout = NetworkLayout.of(hidden)
    # The weights of silu are halved, see pack_network; its table is not.
    scale = "0.5f" if activation == "silu" else "1.0f"
    first = _filled(
        _CUDA_FIRST,
        PLACE=_filled(_CUDA_PLACE, STRIDE=layout.padded[0]) if encoded else "",
        PLACE_SUMS=_filled(_CUDA_PLACE_SUMS, SCALE=scale) if encoded else "",
        SUM0="c[m][0]" if encoded else "b[0]",
        SUM1="c[m][1]" if encoded else "b[1]",
    )
    tiles = [width // 16 for width in layout.padded]
    source = _filled(_CUDA_BEGIN, ACTIVATION=_activation(activation, cuda=True))
    for layer, out in enumerate(tiles):
        source += _filled(
            first if layer == 0 else _CUDA_HIDDEN,
            ACCUMULATORS=_filled(_CUDA_ACCUMULATORS, BIAS=layout.bias_starts[layer]),
            ACTIVATE=_CUDA_ACTIVATE,
            START=layout.fragment_starts[layer],
            OUT=out,
            IN=tiles[layer - 1],
            LAYER=layer,
            NEXT=layer + 1,
        )
    return source + _filled(
        _CUDA_END, START=layout.fragment_starts[-1], IN=tiles[-1], LAYER=len(tiles)
    )


@cache
def color_kernel(hidden: tuple[int, ...], activation: str, encoded: bool = False) -> Any:
    """The kernel of an architecture, with or without a positional encoding; launched over the
    pixels, rounded up to whole warps."""
    source = (
        _PIXEL
        + "#if defined(__CUDA_ARCH__)\n"
        + _cuda_source(hidden, activation, encoded)
        + "#else\n    "
        + _host_source(hidden, activation, encoded)
        + "\n#endif\n"
        + _FINISH
    )

    @wp.func_native(source)
    def color_pixels(
        samples: wp.array(dtype=wp.vec3f),
        rest: wp.array(dtype=wp.vec3f),
        anchor: wp.array(dtype=wp.vec3f),
        background: wp.array(dtype=wp.vec3f),
        sensitivity: wp.array(dtype=wp.vec3f),
        norm: vec15f,
        fragments: wp.array(dtype=wp.uint32),
        biases: wp.array(dtype=wp.float32),
        plain: wp.array(dtype=wp.float32),
        place: wp.array(dtype=wp.float32),
        image: wp.array(dtype=wp.uint8),
        levels: wp.array(dtype=wp.float32),
        i: int,
        count: int,
        pixel_count: int,
        width: int,
        still_levels: float,
        mode: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        samples: wp.array(dtype=wp.vec3f),
        rest: wp.array(dtype=wp.vec3f),
        anchor: wp.array(dtype=wp.vec3f),
        background: wp.array(dtype=wp.vec3f),
        sensitivity: wp.array(dtype=wp.vec3f),
        norm: vec15f,
        fragments: wp.array(dtype=wp.uint32),
        biases: wp.array(dtype=wp.float32),
        plain: wp.array(dtype=wp.float32),
        place: wp.array(dtype=wp.float32),
        count: int,
        width: int,
        still_levels: float,
        mode: int,
        # Out
        image: wp.array(dtype=wp.uint8),
        levels: wp.array(dtype=wp.float32),
    ):
        i = wp.tid()
        color_pixels(
            samples,
            rest,
            anchor,
            background,
            sensitivity,
            norm,
            fragments,
            biases,
            plain,
            place,
            image,
            levels,
            i,
            count,
            rest.shape[0],
            width,
            still_levels,
            mode,
        )

    return kernel
