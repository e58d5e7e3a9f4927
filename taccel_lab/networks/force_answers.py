# SPDX-License-Identifier: Apache-2.0
"""Does a force model answer forces that a press can have? ``signals.force_network`` reads images
with it; here the same layers see a few made-up changes of colour, in numpy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.networks.answers import ACTIVATIONS
from taccel_lab.networks.force_settings import LEVELS, ForceModelConfig

MOST_FORCE_N = 1000.0
"""No gel of a tactile sensor is pressed harder."""
BEYOND = 30.0
"""Times the largest force of the training: what a network may answer to images that are none."""
_DENT_LEVELS = 16.0
"""Change of colour in the made-up dents, where the training reached so far."""


def require_forces(config: ForceModelConfig, weights: Mapping[str, np.ndarray]) -> None:
    """Refuse a network that answers to faint dents, or to none, what no press has."""
    with np.errstate(over="ignore", invalid="ignore"):
        forces = patch_forces(config, weights, _dents(config, weights["colors.most"]))
        answers = np.abs(forces.sum(axis=(-2, -1)))
    answers = np.where(np.isfinite(answers), answers, np.inf)
    most_n = min(BEYOND * max(config.most[:2]), MOST_FORCE_N)
    if not answers.max() <= most_n:
        raise InputError(
            f"the force model answers {answers.max():.3g} N to a faint dent; at most "
            f"{most_n:.3g} N are possible, {BEYOND:g} times the most of its training or 1000: its "
            "weights or its settings are those of another network, or scaled"
        )


def _dents(config: ForceModelConfig, reach: np.ndarray) -> np.ndarray:
    """Changes of colour over ``LEVELS``: none, and a round dent that is darker, brighter, or of
    another colour at either side, [4, 3, height, width]."""
    height, width = config.input_px
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    dent = np.exp(-8 * (x**2 + y**2))
    lean = x * dent
    level = min(_DENT_LEVELS, float(reach.min())) / LEVELS
    none = np.zeros_like(dent)
    return level * np.stack([[none] * 3, [-dent] * 3, [dent] * 3, [lean, none, -lean]])


def patch_forces(
    config: ForceModelConfig, weights: Mapping[str, np.ndarray], change: np.ndarray
) -> np.ndarray:
    """Forces of the patches at the modulus of the training [N], [n, 3, row, column]; markers that
    are seen rest."""
    silu = ACTIVATIONS["silu"]
    count, _, height, width = change.shape
    place = np.stack(
        np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")[::-1]
    )
    x = np.concatenate([change, np.broadcast_to(place, (count, *place.shape))], axis=1)
    x = x.astype(np.float32)
    for k in range(len(config.widths)):
        x = silu(_convolved(x, weights[f"down{k}.weight"], weights[f"down{k}.bias"], 2))
    for k in range(config.blocks):
        seen = x
        if config.markers and k == 0:
            rest = np.zeros((count, 3, *x.shape[2:]), dtype=np.float32)
            rest[:, 2] = 1.0
            seen = np.concatenate([x, rest], axis=1)
        x = x + silu(_convolved(seen, weights[f"block{k}.weight"], weights[f"block{k}.bias"], 1))
    patch = np.tensordot(weights["patch.weight"][:3, :, 0, 0], x, ([1], [1])).swapaxes(0, 1)
    scale = np.array(config.patch_scale_n)[:, None, None]
    return (patch + weights["patch.bias"][:3, None, None]) * scale


def _convolved(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, stride: int) -> np.ndarray:
    """3 x 3 convolution of images [n, channel, height, width] with a border of zeros."""
    padded = np.pad(x, ((0, 0), (0, 0), (1, 1), (1, 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(2, 3))
    windows = windows[:, :, ::stride, ::stride]
    found = np.tensordot(weight, windows, ([1, 2, 3], [1, 4, 5]))
    return found.swapaxes(0, 1) + bias[:, None, None]
