# SPDX-License-Identifier: Apache-2.0
"""A small network that is taught to answer as an ensemble does, and how far off it stays.

It has to give the ensemble's tilt, in shares of the error that the ensemble expects, and that error
(G. Hinton, O. Vinyals and J. Dean, Distilling the knowledge in a neural network, 2015). It begins
as one of the members, off by half of that error, which saves most of the steps of a random one, and
stays as large: with three quarters of its neurons a third of Taxim's blocks are left to the
ensemble, with all of them a tenth. A further output says how far its tilt is off the ensemble's.
That one is fitted last, to what the network was not shown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import silu

from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.response.training import arrays_of, descend, one_thread, trainable
from taccel_lab.networks.normal_settings import (
    SMALL,
    NormalModelConfig,
    ensemble_of,
    small_of,
)
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.network_answers import network
from taccel_lab.reading.slopes import RAYLEIGH_MEAN, NormalModel
from taccel_lab.signals.tensors import layer_tensors

TASK = "teaching the small network"
STEPS, RATE = 2, 0.5
"""Its steps and learning rate over those of the ensemble's fit."""
WARM_UP = 0.15
AT_REST = 8
"""One of so many pixels is shown at rest as well, which is to be 0."""
ERROR_WEIGHT = 0.3
"""Weight of the ensemble's error in the loss, beside the tilt's."""
ROUNDS, MOST_EXCESS = 20, 2.0
"""Rounds of the fit of what it is off, and the largest relative excess of a square in them."""
RIDGE = 1e-4
"""Weight of small weights in least squares, beside mean squares of values."""
TINY = 1e-20


class Lesson(NamedTuple):
    """Answers of an ensemble."""

    inputs: torch.Tensor
    """Network inputs, shape [n, feature]."""
    answers: torch.Tensor
    """Tilt [rad] and expected angle of error [rad], shape [n, 3]."""

    @classmethod
    def joined(cls, lessons: Iterable[Lesson]) -> Lesson:
        """All in one."""
        return cls(*map(torch.cat, zip(*lessons, strict=True)))

    @classmethod
    def by(cls, model: NormalModel, inputs: torch.Tensor) -> Lesson:
        """Answers of the ensemble of ``model`` to network inputs [n, feature]."""
        config = model.config
        mean, scale = (np.array(x, np.float32) for x in (config.input_mean, config.input_scale))
        tilt, error = model.predict_pixels(inputs.numpy() * scale + mean)
        return cls(inputs, torch.from_numpy(np.column_stack([tilt, error])))

    def some(self, count: int, rng: np.random.Generator) -> Lesson:
        """Some of them, ``count`` at most."""
        kept = torch.from_numpy(rng.permutation(len(self.inputs))[:count])
        return Lesson(self.inputs[kept], self.answers[kept])


@one_thread()
def taught(
    model: NormalModel,
    shown: Lesson,
    left_out: Lesson,
    options: InverseFitOptions,
    before: NormalModel | None = None,
    progress: Progress = silent,
) -> NormalModel:
    """The ensemble with a small network beside it; deterministic for the seed of ``options``.

    Args:
        model: The ensemble, complete: its expected errors are learnt with their factor.
        shown: What is learnt.
        left_out: What the network is not shown, which tells how far it is off.
        options: Those of the ensemble's fit.
        before: Networks from whose small one this goes on; from a member when None.
        progress: Told of the steps.
    """
    config = replace(model.config, small_hidden=model.config.hidden)
    still = config.normalise(np.zeros((1, config.input_count), dtype=np.float32))
    pupil = _Pupil(config, torch.from_numpy(still[0, : config.varying_count]))
    pupil.begin({} if before is None else small_of(before.weights), model.weights)
    pupil.learn(shown, options, progress)
    return pupil.beside(model, left_out)


class _Pupil:
    """The small network while it learns."""

    def __init__(self, config: NormalModelConfig, still: torch.Tensor) -> None:
        """``still``: network inputs of no change."""
        self.config, self.still = config, still

    def begin(self, before: Mapping[str, np.ndarray], ensemble: Mapping[str, np.ndarray]) -> None:
        """Take weights of a small network before this, or of a member."""
        weights = {name: values.copy() for name, values in before.items()}
        if not weights:
            weights = {name: values[0] for name, values in ensemble_of(ensemble).items()}
            last = f"layer{len(self.config.small_hidden)}"
            for name in (f"{last}.weight", f"{last}.bias"):
                weights[name] = np.concatenate([weights[name], weights[name][2:]])
        self.layers = trainable(layer_tensors({n: w[None].copy() for n, w in weights.items()}))

    def learn(self, lesson: Lesson, options: InverseFitOptions, progress: Progress) -> None:
        """Train as the ensemble was."""
        generator = torch.Generator().manual_seed(options.seed)
        batch, steps = options.batch_pixels, STEPS * options.steps

        def loss() -> torch.Tensor:
            drawn = torch.randint(len(lesson.inputs), (batch,), generator=generator)
            return self._loss(lesson.inputs[drawn], lesson.answers[drawn])

        descend(
            self.layers, loss, lambda step, _: progress(TASK, step, steps),
            steps=steps, learning_rate=RATE * options.learning_rate, warm_up=WARM_UP,
            matrices=[weight for weight, _ in self.layers[:-1]],
        )  # fmt: skip

    def _at_rest(self, inputs: torch.Tensor) -> torch.Tensor:
        """Network inputs [n, feature] of the same places without a change."""
        return torch.cat([self.still.expand(len(inputs), -1), inputs[:, len(self.still) :]], dim=1)

    def _loss(self, inputs: torch.Tensor, answers: torch.Tensor) -> torch.Tensor:
        still = self._at_rest(inputs[: max(1, len(inputs) // AT_REST)])
        outputs = network(self.layers, torch.cat([inputs, still])[None])[0]
        given, resting = outputs[: len(inputs)], outputs[len(inputs) :]
        tilt, error = answers[:, :2], answers[:, 2]
        off2 = (given[:, :2] - tilt).square().sum(dim=1)
        resting2 = resting[:, :2].square().sum(dim=1)
        share = (off2 / error.square()).sum() + (resting2 / error[: len(still)].square()).sum()
        return share / len(outputs) + ERROR_WEIGHT * (given[:, 2] - error.log()).square().mean()

    @torch.no_grad()
    def beside(self, model: NormalModel, left_out: Lesson) -> NormalModel:
        """The model with this network, which is off by as much as it is on what was left out."""
        inputs = left_out.inputs
        hidden, still = (
            silu(network(self.layers[:-1], given[None]))[0]
            for given in (inputs, self._at_rest(inputs))
        )
        weight, bias = (values[0] for values in self.layers[-1])
        tilt = (hidden - still) @ weight[:2].T
        off2 = (tilt - left_out.answers[:, :2]).square().sum(dim=1)
        of_off, at_zero = logarithm_of(hidden.numpy(), off2.numpy())
        # Expected errors are mean angles, not roots of mean squares.
        weight[3], bias[3] = torch.from_numpy(of_off), at_zero + math.log(RAYLEIGH_MEAN / 2**0.5)
        names = [name for name in self.config.weight_shapes() if name.startswith(SMALL)]
        small = arrays_of(dict.fromkeys(names, ()), [(w[0], b[0]) for w, b in self.layers])
        weights = {**model.weights, **small}
        return NormalModel(self.config, weights, model.device)


def logarithm_of(values: np.ndarray, squares: np.ndarray) -> tuple[np.ndarray, float]:
    """Weight [m] and bias of the logarithm of the root of ``squares`` [n] that is linear in
    ``values`` [n, m] and likeliest, taking these for squares of normal deviates.

    By Fisher's scoring: least squares to what was found before and half of the relative excess.
    """
    terms = np.column_stack([values.astype(np.float64), np.ones(len(values))])
    gram = terms.T @ terms
    gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    found = np.full(len(squares), 0.5 * np.log(max(float(squares.mean()), TINY)))
    line = np.zeros(len(gram))
    for _ in range(ROUNDS):
        excess = np.minimum(squares * np.exp(-2.0 * found) - 1.0, MOST_EXCESS)
        line = np.linalg.solve(gram, terms.T @ (found + 0.5 * excess))
        found = terms @ line
    # Few squares exceed that much; all of them count in how large errors are.
    more = 0.5 * np.log(max(float((squares * np.exp(-2.0 * found)).mean()), TINY))
    return line[:-1], float(line[-1] + more)
