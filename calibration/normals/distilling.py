# SPDX-License-Identifier: Apache-2.0
"""What a small network is taught of a fitted ensemble: what a reader will ask of it.

These are blocks of the training presses as they are read, and the pixels of balls, zooms and
synthetic presses that the ensemble was fitted to. Every fourth press, captured or synthetic, is not
shown, and tells how far the network is off. Truth has no part in it, so that scores of presses that
were held out of the ensemble's fit stay what they say.
"""

from __future__ import annotations

import numpy as np
import torch

from taccel_lab.calibration.normals.network_fit import InverseTraining
from taccel_lab.calibration.normals.small_network_fit import Lesson, taught
from taccel_lab.networks.normal_settings import ensemble_of
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.features import Blocks
from taccel_lab.reading.network_answers import Networks
from taccel_lab.reading.slopes import NormalModel

LEFT_OUT = 4
"""One press of this many is not shown; with fewer presses than that the ensemble reads."""
FRAMES = 8
"""Training presses that are read by blocks, at least; less than twice as many."""
BLOCKS, PIXELS, SYNTHETIC = 40_000, 20_000, 30_000
"""Blocks, pixels of captured presses and pixels of synthetic ones that are shown."""
WORTHWHILE = 20_000
"""Multiplications for a pixel below which an ensemble reads as fast as all that goes with it."""


class _Watched(Networks):
    """An ensemble that keeps which blocks it is asked to read, and what it answers."""

    def __init__(self, model: NormalModel) -> None:
        super().__init__(model.config, model.weights, model.device)
        self.seen: list[tuple[torch.Tensor, torch.Tensor]] = []

    def answer(
        self, blocks: Blocks, picked: torch.Tensor | None, left_out: int | None
    ) -> torch.Tensor:
        found = super().answer(blocks, picked, left_out)
        self.seen.append((blocks.features(picked).T, found.T))
        return found


def distilled(
    model: NormalModel,
    training: InverseTraining,
    before: NormalModel | None = None,
    progress: Progress = silent,
) -> NormalModel:
    """The ensemble with a small network beside it; as it is with fewer than ``LEFT_OUT`` presses,
    and where it is small itself (``WORTHWHILE``).

    Args:
        model: The ensemble, complete: its expected errors are learnt with their factor.
        training: What it was fitted to.
        before: Networks fitted to part of that, from whose small one this goes on.
        progress: Told of the steps.
    """
    work = sum(weight.size for weight in ensemble_of(model.weights).values())
    if work < WORTHWHILE or len(training.frames) < LEFT_OUT:
        return model
    rng = np.random.default_rng(training.options.seed)
    shown, left_out = (_lesson(model, training, unseen, rng) for unseen in (False, True))
    return taught(model, shown, left_out, training.options, before, progress)


def _lesson(
    model: NormalModel, training: InverseTraining, unseen: bool, rng: np.random.Generator
) -> Lesson:
    """What is shown, or what is left out."""
    count, synthetic = len(training.frames), np.array(training.synthetic)
    presses = [i for i in range(count) if (i % LEFT_OUT == LEFT_OUT - 1) == unseen]
    border = len(synthetic) - len(synthetic) // LEFT_OUT
    drawn = synthetic[border:] if unseen else synthetic[:border]
    captured = np.concatenate([training.pixels[i] for i in presses])
    part = LEFT_OUT if unseen else 1
    blocks = [_blocks_of(model, training, i) for i in presses[:: max(1, count // FRAMES)]]
    lessons = [Lesson.joined(blocks).some(BLOCKS // part, rng)]
    for rows, most in ((captured, PIXELS), (drawn, SYNTHETIC)):
        picked = rng.permutation(rows)[: most // part].astype(int)
        lessons.append(Lesson.by(model, training.inputs[torch.from_numpy(picked)]))
    return Lesson.joined(lessons)


def _blocks_of(model: NormalModel, training: InverseTraining, index: int) -> Lesson:
    """Blocks of one press as a reader asks for them."""
    scene, watched = training.scene, _Watched(model)
    image = training.frames[index].image.astype(np.float32)
    reader = NormalModel(model.config, model.weights)
    reader.networks = watched
    reader.predict(image, scene.background, mask=scene.mask)
    features, answers = (torch.cat(parts) for parts in zip(*watched.seen, strict=True))
    return Lesson(torch.from_numpy(model.config.normalise(features.numpy())), answers)
