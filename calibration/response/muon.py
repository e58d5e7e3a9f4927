# SPDX-License-Identifier: Apache-2.0
"""Muon: steps that turn all directions of a weight matrix alike.

A gradient of a layer is ruled by few directions, those of the strongest inputs; Adam, which scales
single entries, learns the others slowly. Muon (K. Jordan et al., Muon: An optimizer for hidden
layers in neural networks, 2024) takes the orthogonal matrix nearest to the gradient's mean instead.
torch's own takes single matrices, not those of an ensemble.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch

MOMENTUM = 0.9
"""Of the running mean of gradients; 0.95, as published, does no better in so few steps."""
QUINTIC = (3.4445, -4.7750, 2.0315)
"""Coefficients of the published iteration: five take singular values to about 0.7 to 1.2."""
ITERATIONS = 5


class Muon(torch.optim.Optimizer):
    """Steps on weights [.., outputs, inputs], each along the last two axes."""

    def __init__(self, weights: Iterable[torch.Tensor], lr: float) -> None:
        super().__init__(weights, {"lr": lr, "momentum": MOMENTUM})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:
        """One step along the gradients that are there."""
        for group in self.param_groups:
            for weight in group["params"]:
                state = self.state[weight]
                if not state:
                    state["mean"] = torch.zeros_like(weight)
                mean = state["mean"].lerp_(weight.grad, 1.0 - group["momentum"])
                ahead = weight.grad.lerp(mean, group["momentum"])
                outputs, inputs = weight.shape[-2:]
                length = max(1.0, outputs / inputs) ** 0.5
                weight.add_(nearly_orthogonal(ahead), alpha=-group["lr"] * length)


def nearly_orthogonal(matrices: torch.Tensor) -> torch.Tensor:
    """Matrices [.., m, n] with their singular values brought near to 1, same shape."""
    a, b, c = QUINTIC
    wide = matrices if matrices.shape[-2] <= matrices.shape[-1] else matrices.mT
    found = wide / (wide.norm(dim=(-2, -1), keepdim=True) + 1e-7)
    for _ in range(ITERATIONS):
        square = found @ found.mT
        found = a * found + (b * square + c * (square @ square)) @ found
    return found if wide is matrices else found.mT
