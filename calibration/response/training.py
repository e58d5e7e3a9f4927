# SPDX-License-Identifier: Apache-2.0
"""How the small networks of colours and normals are trained.

Weights by ``Muon`` where it is asked for, all else by Adam, with a learning rate that rises and
falls once (L. N. Smith, N. Topin, Super-convergence, 2019; torch's ``OneCycleLR``), on one thread:
batches are small, and sums then do not depend on the machine. Layers are pairs of weight and bias,
with members of an ensemble along the first axis or without one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
import torch

from taccel_lab.calibration.response.muon import Muon

Layers = Sequence[tuple[torch.Tensor, torch.Tensor]]
LEAST_SCHEDULE = 11
"""Steps that the learning rate is planned for at least."""
AGAIN_STEPS = 30
"""Steps of a fit that goes on from another, of a hundred of the first."""
AGAIN_RATE = 0.5
"""Its learning rate against the first one's."""


Settings = TypeVar("Settings", bound=Any)


def going_on(options: Settings) -> Settings:
    """Settings, with ``steps`` and ``learning_rate``, of a fit that goes on from one with these."""
    steps = max(1, options.steps * AGAIN_STEPS // 100)
    return replace(options, steps=steps, learning_rate=AGAIN_RATE * options.learning_rate)


class TrainingStore(Protocol):
    """Keeps a training, so that a later one goes on with it."""

    def restore(self, **parts: Any) -> int:
        """Put back what was kept of torch's optimisers and their schedules and of all else; returns
        the number of steps done."""
        ...

    def keep(self, step: int, **parts: Any) -> None:
        """Told after each step."""
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
