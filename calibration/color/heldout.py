# SPDX-License-Identifier: Apache-2.0
"""Held-out presses scored by a frozen colour model, placed without any part of it.

A render needs to know where the ball was, which no training says. The label that came with the
press does, as the labels of the *training* presses lie against where these were placed
(``LabelPlacement``): nothing of the image is used. A press without a label is placed where its
contact is found in its image (``found``), by the search that knows no colour model.

A press that cannot be placed or has no surface, or that is gone, counts as the bare background. One
whose label its image rejects is rendered where it is found, and stands beside the mean figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import (
    CapturedPress,
    CaptureSet,
    ContactCircle,
)
from taccel_lab.calibration.capture.split import PressSplit
from taccel_lab.calibration.circles.ball_surface import BallSurface, SurfaceMaker
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.circles.usable import place_heldout
from taccel_lab.calibration.color.evaluate import ImageScore, score_image
from taccel_lab.calibration.color.network_fit import ColorFit
from taccel_lab.calibration.color.untouched_light import light_beside
from taccel_lab.calibration.result import in_figures, mean_figures
from taccel_lab.errors import InputError
from taccel_lab.signals.tactile_image import tactile_images

Placement = Literal["label", "found"]


@dataclass(frozen=True)
class HeldoutSet:
    """Presses that only the scores see."""

    captures: CaptureSet
    """Their images are read when the model is frozen, not before."""
    surfaces: SurfaceMaker
    """Makes the surfaces under them, then."""
    split: PressSplit
    """How they were chosen."""

    @classmethod
    def of(
        cls, captures: CaptureSet, split: PressSplit, surfaces: SurfaceMaker
    ) -> HeldoutSet | None:
        """Those of ``captures`` that ``split`` holds out; None where it holds none out."""
        return cls(captures.only(split.heldout), surfaces, split) if split.heldout else None


@dataclass(frozen=True)
class HeldoutPress:
    """A press the fit never saw: capture, render and figures."""

    name: str
    captured: np.ndarray
    """RGB uint8, shape [height_px, width_px, 3]."""
    circle: ContactCircle
    """Circle in which the figures are taken: the label, or what was found without one."""
    placed: ContactCircle
    """Where it is rendered: where its label puts it, or where it was found."""
    placement: Placement
    rejected: bool
    """Whether the image rejects the label."""
    surface: BallSurface
    """Under the press in that circle."""
    rendered: np.ndarray
    """RGB levels in the light of the background, float32, shape [height_px, width_px, 3]."""
    shown: np.ndarray
    """The same in the light of the capture."""
    score: ImageScore
    """Of ``shown``."""
    background_only: ImageScore
    """The captured background alone against the capture."""


@dataclass(frozen=True)
class HeldoutFailure:
    """A press that was held out and cannot be rendered."""

    name: str
    reason: str
    background_only: ImageScore | None
    """None where nobody knows where to look: the worst of the other presses then counts."""
    rejected: bool = False
    """Whether a label was given that the image rejects."""


def score_heldout(
    held: HeldoutSet, fit: ColorFit, shift: LabelPlacement
) -> tuple[list[HeldoutPress], list[HeldoutFailure]]:
    """Place and score the held-out presses; ``fit`` and all that led to it stay as they are.

    ``shift`` comes from the training presses.
    """
    return _HeldoutScoring(held, fit, shift).run()


def mean_heldout(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the held-out presses but those with rejected labels, failures as the bare
    background."""
    kept, failed = in_figures(presses), in_figures(failures)
    return mean_figures([item.score for item in kept] + _bare(presses, failed))


def mean_bare(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the bare background over the same presses."""
    kept, failed = in_figures(presses), in_figures(failures)
    return mean_figures([item.background_only for item in kept] + _bare(presses, failed))


def _bare(presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]) -> list[ImageScore]:
    known = [item.background_only for item in presses]
    known += [item.background_only for item in failures if item.background_only is not None]
    if not known:
        return []
    worst = min(known, key=lambda score: score.crop_psnr_db)
    return [item.background_only or worst for item in failures]


class _HeldoutScoring:
    def __init__(self, held: HeldoutSet, fit: ColorFit, shift: LabelPlacement) -> None:
        self.captures, self.make, self.split = held.captures, held.surfaces, held.split
        self.fit, self.shift = fit, shift
        self.grid, self.mask = held.captures.grid, held.captures.mask
        self.failures: list[HeldoutFailure] = [
            HeldoutFailure(name, "it was left out of the captures", None)
            for name in held.split.gone
        ]

    def run(self) -> tuple[list[HeldoutPress], list[HeldoutFailure]]:
        started: list[tuple[CapturedPress, np.ndarray, ContactCircle]] = []
        for press in self.captures.presses:
            image = press.image()
            try:
                started.append((press, image, self._start(press, image)))
            except InputError as error:
                failure = HeldoutFailure(press.name, str(error), None, press.mislabelled)
                self.failures.append(failure)
        surfaces = self._surfaces([s[0] for s in started], [s[2] for s in started])
        found = []
        for (press, image, start), surface in zip(started, surfaces, strict=True):
            figures_in = press.circle or start
            bare = score_image(self.captures.background, image, figures_in, self.grid)
            if isinstance(surface, str):
                self.failures.append(HeldoutFailure(press.name, surface, bare, press.mislabelled))
                continue
            found.append(self._scored(press, image, figures_in, start, surface, bare))
        return found, self.failures

    def _start(self, press: CapturedPress, image: np.ndarray) -> ContactCircle:
        """Where the label puts a press; without a label, where its contact is found."""
        found = place_heldout(press, image, self.captures, self.shift)
        return found.up_to_equator(press.radius_mm or self.captures.ball_radius_mm, self.grid)

    def _surfaces(
        self, presses: Sequence[CapturedPress], circles: Sequence[ContactCircle]
    ) -> list[BallSurface | str]:
        """The surfaces, or why there is none; one that cannot be made spoils no other."""
        if not presses:
            return []
        chosen = replace(self.captures, presses=tuple(presses))
        try:
            return list(self.make(chosen, circles))
        except InputError:
            found: list[BallSurface | str] = []
            for i, circle in enumerate(circles):
                try:
                    found += self.make(chosen.only([i]), [circle])
                except InputError as error:
                    found.append(f"it has no surface: {error}")
            return found

    def _scored(
        self,
        press: CapturedPress,
        image: np.ndarray,
        figures_in: ContactCircle,
        start: ContactCircle,
        surface: BallSurface,
        bare: ImageScore,
    ) -> HeldoutPress:
        (rendered,) = tactile_images(self.fit.model, self.fit.background, [surface])
        # Against the render, which has the gel's shade beside the contact, too.
        light = light_beside(image, rendered, figures_in, self.grid, self.mask)
        shown = np.clip(light.apply(rendered), 0.0, 255.0)
        return HeldoutPress(
            press.name, image, figures_in, start, "found" if press.circle is None else "label",
            press.mislabelled, surface, rendered, shown,
            score_image(shown, image, figures_in, self.grid), bare,
        )  # fmt: skip
