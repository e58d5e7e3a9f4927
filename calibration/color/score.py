# SPDX-License-Identifier: Apache-2.0
"""Held-out presses rendered by a frozen colour model, and scored.

A press that cannot be placed, or that is gone, counts as the bare background. One whose label its
image rejects is rendered where it is found, and stands beside the mean figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.calibration.color.network_fit import ColorFit
from taccel_lab.calibration.response.evaluate import ImageScore, score_image
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.calibration.response.heldout import HeldoutFailure
from taccel_lab.calibration.response.untouched_light import light_beside
from taccel_lab.calibration.result import in_figures, mean_figures
from taccel_lab.signals.tactile_image import tactile_images

Placement = Literal["label", "found"]


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
    """Surface under the press in that circle."""
    rendered: np.ndarray
    """RGB levels in the light of the background, float32, shape [height_px, width_px, 3]."""
    shown: np.ndarray
    """The same in the light of the capture."""
    score: ImageScore
    """Score of ``shown``."""
    background_only: ImageScore
    """The captured background alone against the capture."""


def score_heldout(
    press: CapturedPress,
    frame: PressFrame,
    fit: ColorFit,
    scene: CaptureScene,
    captured_background: np.ndarray,
) -> HeldoutPress:
    """A press in its place, rendered by ``fit`` and compared with its capture."""
    figures_in = press.circle or frame.circle
    (rendered,) = tactile_images(fit.model, fit.background, [frame.surface])
    shown = in_light_of(frame.image, rendered, figures_in, scene)
    return HeldoutPress(
        press.name, frame.image, figures_in, frame.circle,
        "found" if press.circle is None else "label", press.mislabelled, frame.surface, rendered,
        shown,
        score_image(shown, frame.image, figures_in, scene.grid),
        score_image(captured_background, frame.image, figures_in, scene.grid),
    )  # fmt: skip


def in_light_of(
    captured: np.ndarray, rendered: np.ndarray, circle: ContactCircle, scene: CaptureScene
) -> np.ndarray:
    """A render in the light of its capture, levels, shape [height_px, width_px, 3]."""
    # Against the render, which has the gel's shade beside the contact, too.
    light = light_beside(captured, scene, circle, rendered)
    return np.clip(light.apply(rendered), 0.0, 255.0)


def mean_heldout(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the held-out presses but those with rejected labels, failures as the bare
    background."""
    return mean_figures([item.score for item in in_figures(presses)] + _bare(presses, failures))


def mean_bare(
    presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]
) -> dict[str, float]:
    """Mean figures of the bare background over the same presses."""
    kept = [item.background_only for item in in_figures(presses)]
    return mean_figures(kept + _bare(presses, failures))


def _bare(presses: Sequence[HeldoutPress], failures: Sequence[HeldoutFailure]) -> list[ImageScore]:
    """What failures count as: nobody knows where to look, so the worst background of the others."""
    worst = min((item.background_only for item in presses), key=lambda score: score.crop_psnr_db)
    return [worst] * len(in_figures(failures))
