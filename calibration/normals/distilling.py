# SPDX-License-Identifier: Apache-2.0
"""Lessons of a small network by a fitted ensemble: blocks that a reader will ask about.

These are blocks of the training presses as they are read, and the pixels of balls, zooms and
synthetic presses that the ensemble was fitted to. Every fourth press, captured or synthetic, is not
shown, and tells how far the network is off. Truth has no part in it, so that scores of presses that
were held out of the ensemble's fit stay what they say.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from taccel_lab.calibration.circles.ball_surface import layer_of
from taccel_lab.calibration.normals.network_fit import InverseTraining
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.normals.small_network_fit import Lesson, taught
from taccel_lab.calibration.normals.synthetic_presses import ImageNoise, SyntheticPresses
from taccel_lab.calibration.response.frame import CaptureScene
from taccel_lab.errors import InputError
from taccel_lab.networks.normal_settings import ensemble_of
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.features import Blocks
from taccel_lab.reading.network_answers import Networks
from taccel_lab.reading.reader import Reader
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.rest_surface import rest_surface

LEFT_OUT = 4
"""One press of this many is not shown; with fewer presses than that the ensemble reads."""
FRAMES = 8
"""Training presses that are read by blocks, at least; less than twice as many."""
BLOCKS, PIXELS, SYNTHETIC = 40_000, 20_000, 30_000
"""Blocks, pixels of captured presses and pixels of synthetic ones that are shown."""
PRESSES, DEEPEST = 64, 0.2
"""Synthetic presses that a profile without captures is taught by, and the share of the gel's
thickness that balls are taken to be pressed in it."""
USUAL_NOISE = ImageNoise(1.0, 1.0, 0.1)
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
    """Lesson of what is shown, or of what is left out."""
    count, synthetic = len(training.frames), np.array(training.synthetic)
    presses = [i for i in range(count) if (i % LEFT_OUT == LEFT_OUT - 1) == unseen]
    border = len(synthetic) - len(synthetic) // LEFT_OUT
    drawn = synthetic[border:] if unseen else synthetic[:border]
    captured = np.concatenate([training.pixels[i] for i in presses])
    part = LEFT_OUT if unseen else 1
    frames = [training.frames[i] for i in presses[:: max(1, count // FRAMES)]]
    blocks = [_blocks_of(model, frame.image, training.scene) for frame in frames]
    lessons = [Lesson.joined(blocks).some(BLOCKS // part, rng)]
    for rows, most in ((captured, PIXELS), (drawn, SYNTHETIC)):
        picked = rng.permutation(rows)[: most // part].astype(int)
        lessons.append(Lesson.by(model, training.inputs[torch.from_numpy(picked)]))
    return Lesson.joined(lessons)


def _blocks_of(model: NormalModel, image: np.ndarray, scene: CaptureScene) -> Lesson:
    """Blocks of one image as a reader asks for them."""
    reader, watched = NormalModel(model.config, model.weights), _Watched(model)
    reader.networks = watched
    reader.predict(image.astype(np.float32), scene.background, mask=scene.mask)
    features, answers = (torch.cat(parts) for parts in zip(*watched.seen, strict=True))
    return Lesson(torch.from_numpy(model.config.normalise(features.numpy())), answers)


def with_small_network(
    profile: SensorProfile, photos: Sequence[np.ndarray] = (), seed: int = 0
) -> SensorProfile:
    """A profile whose ensemble reads alone, with a small network that was shown presses of other
    tools in the profile's own pad and colours.

    Args:
        profile: With background, colours and normals; InputError otherwise.
        photos: Of the sensor, RGB levels, shape [height_px, width_px, 3], that are shown as well.
            Without any, depths of a Mini's presses are off the ensemble's by 0.4 of their error,
            with some, those of others by 0.05: colours of a model are not those of a gel.
        seed: Of the tools, and of what is learnt when.
    """
    model, colors = NormalModel.from_profile(profile), ColorModel.from_profile(profile)
    if profile.normals is None or profile.background_rgb is None or colors is None:
        raise InputError(
            f"the profile of {profile.sensor.name} teaches no small network; it needs the blocks "
            "background, color and normals"
        )
    grid, pad = profile.grid(), layer_of(profile)
    rest = rest_surface(profile.mesh, grid)
    background = profile.background_rgb.astype(np.float32)
    scene = CaptureScene(background, grid, 0.0, None, None if rest.is_flat else rest.normals)
    deepest_mm = DEEPEST * pad.thickness_mm
    rng = np.random.default_rng(seed)
    tools = SyntheticPresses(scene, pad, colors, USUAL_NOISE, deepest_mm, rng)
    reader = Reader(profile)
    images = [reader.lit(photo).levels for photo in photos]
    images += [press.image for press in tools.presses(PRESSES)]
    lessons = [_blocks_of(model, image, scene) for image in images]
    left_out = lessons[LEFT_OUT - 1 :: LEFT_OUT]
    shown = [each for i, each in enumerate(lessons) if i % LEFT_OUT != LEFT_OUT - 1]
    both = taught(
        model, Lesson.joined(shown), Lesson.joined(left_out), InverseFitOptions(seed=seed)
    )
    block = profile.normals.replace(architecture=both.config.to_dict())
    return profile.with_block(block, both.weights)
