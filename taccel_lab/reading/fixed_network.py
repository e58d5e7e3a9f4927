# SPDX-License-Identifier: Apache-2.0
"""A kernel that takes blocks through all layers of small networks.

Products of matrices write what each layer gives to memory, and read it again, for some ten
operations a number. Here it stays where it is made, and sums are of the same float32 numbers.
"""

# Warp compiles the kernels from their source.
# pyright: reportArgumentType=false

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import torch
import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.reading.launch import launch

WARPS = 4
"""Warps of a block, of 32 rows each."""
PART = 32
"""Inputs whose weights are in shared memory at once."""


@wp.kernel(enable_backward=False)
def _members_kernel(
    outputs: wp.array3d(dtype=float),
    still: wp.array3d(dtype=float),
    left_out: int,
    factor: float,
    least: float,
    found: wp.array2d(dtype=float),
):
    k = wp.tid()
    members = outputs.shape[0]
    total, own, count = wp.vec2(0.0, 0.0), wp.vec3(0.0, 0.0, 0.0), float(0.0)
    for m in range(members):
        tilt = wp.vec2(outputs[m, k, 0] - still[m, k, 0], outputs[m, k, 1] - still[m, k, 1])
        error = wp.exp(wp.clamp(outputs[m, k, 2], -12.0, 2.0)) + least
        if m != left_out:
            total += tilt
            count += 1.0
        if left_out < 0:
            own += wp.vec3(tilt[0], tilt[1], error) / float(members)
        elif m == left_out:
            own = wp.vec3(tilt[0], tilt[1], error)
    spread = float(0.0)
    for m in range(members):
        if m != left_out:
            p = outputs[m, k, 0] - still[m, k, 0] - total[0] / count
            q = outputs[m, k, 1] - still[m, k, 1] - total[1] / count
            spread += (p * p + q * q) / count
    found[0, k] = own[0]
    found[1, k] = own[1]
    found[2, k] = wp.sqrt(factor * own[2] * factor * own[2] + spread)


def judged(
    outputs: torch.Tensor, still: torch.Tensor, left_out: int | None, factor: float, least: float
) -> torch.Tensor:
    """What ``Networks`` makes of outputs [member, n, 3] and tilts at rest [member, n, 2], shape
    [3, n]; ``factor``: of the expected error, ``least``: of errors [rad]."""
    found = torch.empty((3, outputs.shape[1]), device=outputs.device)
    member = -1 if left_out is None else left_out
    launch(_members_kernel, (outputs.shape[1],), [outputs, still, member, factor, least, found])
    return found


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

    def __call__(self, inputs: torch.Tensor, counted: torch.Tensor | None = None) -> torch.Tensor:
        """Raw outputs, shape [member, n, outputs], of inputs [input, n], any beyond the first ones
        that are ``counted``, int64."""
        members, rows, lanes = len(self._weights), inputs.shape[1], 32 * WARPS
        found = torch.empty((members, self._widths[-1], rows), device=inputs.device)
        size = members, -(-rows // lanes), lanes
        given = [inputs, self._weights, _all(rows, inputs.device), found]
        if counted is not None:
            given[2] = counted.reshape(1)
        launch(_network_kernel(self._widths), size, given, lanes)
        return found.mT


@lru_cache(maxsize=64)
def _all(rows: int, device: torch.device) -> torch.Tensor:
    return torch.tensor([rows], device=device)


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
        counted: wp.array(dtype=wp.int64),
        outputs: wp.array3d(dtype=float),
        member: int,
        block: int,
        thread: int,
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def network_rows_kernel(
        inputs: wp.array2d(dtype=float),
        weights: wp.array2d(dtype=float),
        counted: wp.array(dtype=wp.int64),
        outputs: wp.array3d(dtype=float),
    ):
        member, block, thread = wp.tid()
        network_rows(inputs, weights, counted, outputs, member, block, thread)

    return network_rows_kernel
