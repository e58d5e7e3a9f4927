# SPDX-License-Identifier: Apache-2.0
"""The device kernel of a colour model: the whole network in registers, one launch an image batch.

On CUDA a warp renders 32 pixels. It exchanges their inputs, runs them through the layers with
``mma.sync`` (see ``color_fragments``), and each lane finishes its own pixel; activations never
leave the registers, which is what makes the network cheaper than writing them (the idea of T.
Mueller et al., "Real-time neural radiance caching for path tracing", ACM TOG 40 (2021), there with
shared memory). A warp without a moved pixel copies the background. Elsewhere (the CPU) a thread
runs one pixel in FP32.

The source is generated: loop bounds and layer offsets are constants of the architecture. With a
positional encoding the first layer starts from tabulated sums of the pixel's column and row.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor native functions.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.signals.color_fragments import NetworkLayout

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
