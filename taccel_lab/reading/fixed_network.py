# SPDX-License-Identifier: Apache-2.0
"""A kernel that takes blocks through all layers of small networks.

Products of matrices write what each layer gives to memory, and read it again, for some ten
operations a number. Here it stays where it is made, and sums are of the same float32 numbers.
"""

# Warp compiles the kernels from their source.
# pyright: reportArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.reading.launch import launch

WARPS = 4
"""Warps of a block, of 32 rows each."""
PART = 32
"""Inputs whose weights are in shared memory at once."""


class FixedNetwork:
    """Members of one shape with silu between their layers."""

    def __init__(self, layers: Sequence[tuple[torch.Tensor, torch.Tensor]]) -> None:
        """``layers``: weight [member, outputs, inputs] and bias [member, outputs] of each; no
        hidden one wider than 64, whose sums fit a warp's registers."""
        self._widths = layers[0][0].shape[2], *(len(bias[0]) for _, bias in layers)
        parts = []
        for (weight, bias), wide in zip(layers, _padded(self._widths), strict=True):
            more = [0, wide - weight.shape[1]]
            pad = torch.nn.functional.pad
            parts += [pad(bias, more), pad(weight.mT, more).flatten(1)]
        self._weights = torch.cat(parts, dim=1).contiguous()

    def __call__(self, inputs: torch.Tensor) -> torch.Tensor:
        """Raw outputs, shape [member, n, outputs], of inputs [input, n]."""
        members, rows, lanes = len(self._weights), inputs.shape[1], 32 * WARPS
        found = torch.empty((members, self._widths[-1], rows), device=inputs.device)
        size = members, -(-rows // lanes), lanes
        launch(_network_kernel(self._widths), size, [inputs, self._weights, found], lanes)
        return found.mT


def _padded(widths: tuple[int, ...]) -> list[int]:
    """Outputs of each layer as kernels count them: those of a hidden one are shared by the lanes of
    a warp, four or eight to each."""
    *hidden, last = widths[1:]
    return [*(-(-width // 32) * 32 for width in hidden), -(-last // 4) * 4]


@cache
def _network_kernel(widths: tuple[int, ...]) -> Any:
    """The kernel of networks with so many inputs, then outputs of each layer."""
    padded = _padded(widths)
    common = {
        "WARPS": WARPS, "PART": PART, "MOST": max(padded), "KEPT": max(PART, *padded),
    }  # fmt: skip

    def section(name: str, **values: object) -> str:
        return native("fixed_network", name, **values, **common)

    device, host, start = "", "", 0
    for layer, (count, out) in enumerate(zip(widths, padded, strict=False)):
        last = layer == len(padded) - 1
        places = {"IN": count, "OUT": out, "BIAS": start, "START": start + out}
        given = section("inputs") if layer == 0 else ""
        device += section(
            "last" if last else "layer",
            WEIGHTS=section("weights", INPUTS=given, **places),
            FROM="from" if layer else "0",
            EACH=out // 8,
            REAL=widths[-1],
            **places,
        )
        host += section("host_layer", ACT="y[o]" if last else "act(y[o])", **places)
        start += out * (count + 1)
    source = (
        section("begin")
        + device
        + section("host", WIDEST=max(*padded, *widths), COUNT=widths[0])
        + host
        + section("host_end", REAL=widths[-1])
    )

    @wp.func_native(source)
    def network_rows(
        inputs: wp.array2d(dtype=float),
        weights: wp.array2d(dtype=float),
        outputs: wp.array3d(dtype=float),
        member: int,
        block: int,
        thread: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def network_rows_kernel(
        inputs: wp.array2d(dtype=float),
        weights: wp.array2d(dtype=float),
        outputs: wp.array3d(dtype=float),
    ):
        member, block, thread = wp.tid()
        network_rows(inputs, weights, outputs, member, block, thread)

    return network_rows_kernel
