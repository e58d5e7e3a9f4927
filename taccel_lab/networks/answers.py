# SPDX-License-Identifier: Apache-2.0
"""Do the networks of a profile answer what a sensor can show?

Weights and settings that are each sound may still belong to different networks, or hold a factor by
mistake. So a network is asked, at places drawn over what it was fitted to, and its answers have to
be ones that exist. Without torch, which whoever draws a picture need not load.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from taccel_lab.errors import InputError

QUESTIONS = 256
SHARE_PERCENT = 95
"""Share of the answers that have to exist: a network may go wild in a corner that no capture
reached."""


def forward(weights: Mapping[str, np.ndarray], inputs: np.ndarray, activation: str) -> np.ndarray:
    """Outputs [..., n, outputs] of the layers ``layer<i>.weight`` [..., outputs, inputs] and
    ``layer<i>.bias`` for ``inputs`` [n, inputs]; ``activation``: silu, tanh or relu."""
    values = np.asarray(inputs, dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        for i in range(len(weights) // 2):
            if i:
                values = ACTIVATIONS[activation](values)
            weight, bias = (weights[f"layer{i}.{name}"] for name in ("weight", "bias"))
            values = values @ np.swapaxes(weight, -1, -2) + bias[..., None, :]
    return values


def require_answers(
    what: str, sizes: np.ndarray, least: float, most: float, unit: str, limit: str
) -> None:
    """Refuse a network most of whose answers do not exist, or are next to none. None at all is an
    answer: of a sensor that shows its dots and nothing else.

    Args:
        what: The network, to begin a sentence with.
        sizes: How large its answers are, [n].
        least: What the larger of them reach at least.
        most: The largest that exists.
        unit: Of all.
        limit: What has no larger ones, for "but ...".
    """
    finite = np.where(np.isfinite(sizes), sizes, np.inf)
    size = float(np.percentile(finite, SHARE_PERCENT, method="lower"))
    if size and not least <= size <= most:
        shown = limit if size > most else f"any touch shows {least:g} and more"
        raise InputError(
            f"{what} answers up to {size:.3g} {unit}, but {shown}: its weights or its settings "
            "are those of another network, or scaled"
        )


ACTIVATIONS = {
    "silu": lambda x: x / (1 + np.exp(-x)),
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
}
