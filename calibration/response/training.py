# SPDX-License-Identifier: Apache-2.0
"""How the small networks of colours and normals are trained.

Weights by Muon where it is asked for (K. Jordan et al., Muon: An optimizer for hidden layers in
neural networks, 2024), all else by Adam, with a learning rate that rises and
falls once (L. N. Smith, N. Topin, Super-convergence, 2019; torch's ``OneCycleLR``), on one thread:
batches are small, and sums then do not depend on the machine. Layers are pairs of weight and bias,
with members of an ensemble along the first axis or without one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
import torch

Layers = Sequence[tuple[torch.Tensor, torch.Tensor]]
MOMENTUM = 0.9
"""Factor of the running mean of gradients; 0.95, as published, does no better in so few steps."""
QUINTIC = (3.4445, -4.7750, 2.0315)
"""Coefficients of the published iteration: five take singular values to about 0.7 to 1.2."""
ITERATIONS = 5
LEAST_SCHEDULE = 11
"""Steps that the learning rate is planned for at least."""


class TrainingStore(Protocol):
    """Keeps a training, so that a later one goes on with it."""

    def restore(self, **parts: Any) -> int:
        """Put back what was kept of torch's optimisers and their schedules and of all else; returns
        the number of steps done."""
        ...

    def keep(self, step: int, **parts: Any) -> None:
        """Receives the training after each step."""
        ...


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread inside the block."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def initial_weights(
    shapes: Mapping[str, tuple[int, ...]], generator: torch.Generator
) -> dict[str, np.ndarray]:
    """Uniform in +-1/sqrt(inputs), as torch.nn.Linear draws them.

    ``shapes`` are those of ``NAME.weight`` [.., outputs, inputs] and ``NAME.bias`` [.., outputs].
    """
    weights = {}
    for name, shape in shapes.items():
        bound = 1.0 / np.sqrt(shapes[name.replace("bias", "weight")][-1])
        weights[name] = ((torch.rand(shape, generator=generator) * 2 - 1) * bound).numpy()
    return weights


def trainable(layers: Layers) -> Layers:
    """The layers with gradients."""
    return [(weight.requires_grad_(), bias.requires_grad_()) for weight, bias in layers]


def arrays_of(shapes: Mapping[str, tuple[int, ...]], layers: Layers) -> dict[str, np.ndarray]:
    """Copies of the layers' values by name."""
    tensors = (tensor for layer in layers for tensor in layer)
    return {
        name: tensor.detach().numpy().copy() for name, tensor in zip(shapes, tensors, strict=True)
    }


def descend(
    layers: Layers,
    loss: Callable[[], torch.Tensor],
    after_step: Callable[[int, torch.Tensor], None],
    *,
    steps: int,
    learning_rate: float,
    warm_up: float,
    matrices: Sequence[torch.Tensor] = (),
    keeper: TrainingStore | None = None,
) -> None:
    """Lower ``loss`` over the layers' values.

    Args:
        layers: What is trained, with gradients.
        loss: The loss of a fresh batch.
        after_step: Told the number of steps done and the loss before the last one.
        steps: Number of steps.
        learning_rate: Its peak.
        warm_up: Share of the steps in which it rises.
        matrices: Those of the weights that ``Muon`` steps; Adam steps the others. The last layer's
            do not belong there: its outputs have units of their own.
        keeper: Goes on with what was kept of an interrupted training, and keeps this one.
    """
    by_muon = {id(weight) for weight in matrices}
    others = [tensor for layer in layers for tensor in layer if id(tensor) not in by_muon]
    optimizers: list[torch.optim.Optimizer] = [
        torch.optim.Adam(others, lr=learning_rate, fused=True),
        *([Muon(matrices, learning_rate)] if matrices else []),
    ]
    # A rise of a single step divides by zero in torch.
    schedules = [
        torch.optim.lr_scheduler.OneCycleLR(
            optimizer,
            learning_rate,
            total_steps=max(steps + 1, LEAST_SCHEDULE),
            pct_start=warm_up,
            cycle_momentum=not matrices,
        )
        for optimizer in optimizers
    ]
    parts = {  # Adam's as they were called when it stepped all: trainings begun then go on.
        f"{name}{i or ''}": part
        for name, several in (("optimizer", optimizers), ("schedule", schedules))
        for i, part in enumerate(several)
    }
    done = 0 if keeper is None else keeper.restore(**parts)
    for step in range(done + 1, steps + 1):
        value = loss()
        for optimizer in optimizers:
            optimizer.zero_grad()
        value.backward()
        for optimizer, schedule in zip(optimizers, schedules, strict=True):
            optimizer.step()
            schedule.step()
        after_step(step, value)
        if keeper is not None:
            keeper.keep(step, **parts)


class Muon(torch.optim.Optimizer):
    """Steps on weights [.., outputs, inputs] that turn all directions of a matrix alike.

    A gradient of a layer is ruled by few directions, those of the strongest inputs; Adam, which
    scales single entries, learns the others slowly. Muon takes the orthogonal matrix nearest to the
    gradient's mean instead. torch's own takes single matrices, not those of an ensemble.
    """

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
