# SPDX-License-Identifier: Apache-2.0
"""Held-out presses, placed without any part of the model that is scored on them.

Figures need to know where the ball was, which no training says. The label that came with the press
does, as the labels of the *training* presses lie against where these were placed
(``LabelPlacement``): nothing of the image is used. A press without a label is placed where its
contact is found in its image, by the search that knows no model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from taccel_lab.calibration.capture.captures import (
    CapturedPress,
    CaptureSet,
    ContactCircle,
    PressSplit,
)
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.circles.usable import place_heldout
from taccel_lab.calibration.response.frame import PressFrame
from taccel_lab.errors import InputError

SurfaceOf = Callable[[ContactCircle, float], BallSurface]
"""Surface under a ball of a radius [mm] in a circle; InputError where it cannot leave that."""


@dataclass(frozen=True)
class HeldoutFailure:
    """A press that was held out and cannot be placed."""

    name: str
    reason: str
    rejected: bool = False
    """Whether a label was given that the image rejects."""


@dataclass(frozen=True)
class HeldoutSet:
    """Presses that only the scores see."""

    captures: CaptureSet
    """Their images are read when the model is frozen, not before."""
    split: PressSplit
    """How they were chosen."""
    surface_of: SurfaceOf

    @classmethod
    def of(cls, captures: CaptureSet, split: PressSplit, surface_of: SurfaceOf) -> HeldoutSet:
        """Presses of ``captures`` that ``split`` holds out, which may be none."""
        return cls(captures.only(split.heldout), split, surface_of)

    @property
    def count(self) -> int:
        """How many were held out, those included that are gone."""
        return len(self.captures.presses) + len(self.split.gone)

    def placed(
        self, labels: LabelPlacement
    ) -> Iterator[tuple[CapturedPress, PressFrame] | HeldoutFailure]:
        """Each press with its frame where its label puts it or where it was found, or why it has no
        place; those that are gone come first. ``labels`` comes from the training presses."""
        for name in self.split.gone:
            yield HeldoutFailure(name, "it was left out of the captures")
        for press in self.captures.presses:
            ball_mm = press.radius_mm or self.captures.ball_radius_mm
            try:
                image = press.image()
                circle = place_heldout(press, image, self.captures, labels)
                circle = circle.up_to_equator(ball_mm, self.captures.grid)
                surface = self.surface_of(circle, ball_mm)
                yield press, PressFrame(press.name, image, circle, surface, press.sha256)
            except InputError as error:
                yield HeldoutFailure(press.name, str(error), press.mislabelled)
