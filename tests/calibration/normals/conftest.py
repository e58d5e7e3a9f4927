# SPDX-License-Identifier: Apache-2.0
"""Fits of normals to synthetic presses, made once for all tests of this folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.circles.ball_surface import BallSurface, ball_surface, layer_surfaces
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.normals.fit import fit_normals
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.response.frame import FittedPresses, HeldoutSet, SurfaceOf
from taccel_lab.reading.bonded_layer import BondedLayer
from taccel_lab.signals.rest_surface import flat_rest
from tests.support.synthetic_presses import (
    GRID,
    circles_of,
    flat_background,
    known_change,
    synthetic_captures,
    true_surface,
    with_images,
)

QUICK = InverseFitOptions(
    disc_pixels=600, sink_in_pixels=600, flat_pixels=200, zooms=2,
    members=3, hidden=(24, 24), steps=350, batch_pixels=384,
)  # fmt: skip
SHORT_FIT = ColorFitOptions(
    hidden=(48, 48), steps=160, batch_pixels=1024, disc_pixels=1500, ring_pixels=900,
    far_pixels=200, learning_rate=2e-2,
)  # fmt: skip
PAD = BondedLayer(4.0, 0.48)
ON_PAD = partial(ball_surface, grid=GRID, layer=PAD, rest=flat_rest(GRID))
Clean = tuple[CaptureSet, list[BallSurface], NormalCalibration]


@contextmanager
def short_color_fits() -> Iterator[None]:
    """What presses of other tools are drawn with takes ten times as long as the networks here."""
    with pytest.MonkeyPatch.context() as patch:
        options = "taccel_lab.calibration.normals.fit.ColorFitOptions"
        patch.setattr(options, lambda seed: replace(SHORT_FIT, seed=seed))
        yield


@pytest.fixture(autouse=True)
def _colors_of_synthetic_presses_are_fitted_shortly() -> Iterator[None]:
    """In this folder's tests alone: files of other folders may run in the same process."""
    with short_color_fits():
        yield


@pytest.fixture
def one_thread() -> None:
    """Sums come out alike on every machine."""
    torch.set_num_threads(1)


def calibrated(
    captures: CaptureSet,
    surfaces: list[BallSurface],
    surface_of: SurfaceOf = true_surface,
    **changes: object,
) -> NormalCalibration:
    known_of = {item.name for item in fields(FittedPresses)} & changes.keys()
    settings: dict[str, Any] = {"options": QUICK} | changes
    more = {name: settings.pop(name) for name in known_of}
    split = captures.split(4)
    training, known = captures.only(split.train), [surfaces[i] for i in split.train]
    held = HeldoutSet.of(captures, split, surface_of)
    with short_color_fits():  # fixtures of the whole run come before those of a test
        presses = FittedPresses(training, circles_of(training), known, held, **more)
        return fit_normals(presses, **settings)


def changed(
    captures: CaptureSet, change: Callable[[np.ndarray, int], np.ndarray], **more: object
) -> CaptureSet:
    """The captures with ``change(image, index)`` in the place of each image."""
    images = [change(press.image(), i) for i, press in enumerate(captures.presses)]
    return with_images(captures, images, **more)


@pytest.fixture(scope="session")
def clean() -> Clean:
    torch.set_num_threads(1)
    captures, surfaces = synthetic_captures(16, noise=0.0)
    return captures, surfaces, calibrated(captures, surfaces)


def sunk_captures() -> tuple[CaptureSet, list[BallSurface]]:
    """Balls whose gel sinks around them as a bonded layer does."""
    captures, _ = synthetic_captures(16, noise=0.0)
    surfaces = layer_surfaces(captures, circles_of(captures), PAD, flat_rest(GRID))
    images = [np.clip(flat_background() + known_change(s), 0, 255) for s in surfaces]
    return with_images(captures, images), surfaces


@pytest.fixture(scope="session")
def stages() -> dict[str, tuple[int, int]]:
    """What the fit of ``synthetic`` said last of each of its stages, in order: done, in all."""
    return {}


@pytest.fixture(scope="session")
def synthetic(stages: dict[str, tuple[int, int]]) -> NormalCalibration:
    """Networks trained on other tools."""
    torch.set_num_threads(1)
    captures, surfaces = sunk_captures()
    options = replace(QUICK, steps=800, synthetic_presses=24)

    def progress(task: str, done: int, total: int) -> None:
        stages[task] = done, total

    return calibrated(captures, surfaces, ON_PAD, options=options, pad=PAD, progress=progress)
