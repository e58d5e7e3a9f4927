# SPDX-License-Identifier: Apache-2.0
"""Held-out presses read once by the frozen model, and bands that hold these, too."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.circles.ball_surface import LARGEST_RADII, deeper_per_mm
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.normals.reading_error import errors_of, widened
from taccel_lab.calibration.normals.samples import KnownPress
from taccel_lab.calibration.normals.score import HeldoutNormals, score_heldout
from taccel_lab.calibration.response.frame import CaptureScene, CircleSigma, PressFrame
from taccel_lab.calibration.response.heldout import HeldoutFailure, HeldoutSet
from taccel_lab.calibration.response.untouched_light import in_background_light
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.read_heights import ReadHeights, read_heights

READING = "reading the held-out presses"


@dataclass(frozen=True)
class HeldoutReading:
    """Presses that nothing had seen, as the model reads them."""

    model: NormalModel
    """The frozen one, its bands widened to hold these presses: figures of bands are of it."""
    items: tuple[HeldoutNormals, ...]
    failures: dict[str, str]
    """Presses that could not be placed, and why."""

    def joining(self) -> list[PressFrame]:
        """The presses as the last fit takes them. One that is read no better than by a flat guess
        shows something else."""
        return [i.frame for i in self.items if i.used.mean_deg < i.used.flat_deg]


def read_heldout(
    model: NormalModel,
    heldout: HeldoutSet,
    labels: LabelPlacement,
    scene: CaptureScene,
    circle_sigma_px: CircleSigma,
    progress: Progress = silent,
) -> HeldoutReading:
    """Place each press by its label, read it, widen the bands, and score it.

    Args:
        model: The frozen one.
        heldout: The presses.
        labels: Where their labels put them.
        scene: What they share with the training presses.
        circle_sigma_px: Of the circles of training presses.
        progress: Told of each press.
    """
    failures, found, errors = {}, [], []
    for placed in counted(heldout.placed(labels), progress, READING, heldout.count):
        if isinstance(placed, HeldoutFailure):
            failures[placed.name] = placed.reason
            continue
        press, captured = placed
        sigma_px = circle_sigma_px
        if press.circle is not None:
            sigma_px = labels.sigma_px(circle_sigma_px)
        image = in_background_light(captured.image.astype(np.float32), scene)
        frame = replace(captured, image=image, circle_sigma_px=sigma_px)
        found.append((press, frame))
        if not press.mislabelled:
            known = KnownPress.of_ball(frame, scene, rise_sigma_m=_rise_sigma_m(frame, scene))
            errors.append(errors_of(model, known, scene, _read(model, frame, scene, False)))
    model = widened(model, [error for error in errors if error is not None])
    items = [
        score_heldout(
            _read(model, frame, scene), frame, press.circle, scene, rejected=press.mislabelled
        )
        for press, frame in found
    ]
    return HeldoutReading(model, tuple(items), failures)


def _read(
    model: NormalModel, frame: PressFrame, scene: CaptureScene, uncertainty: bool = True
) -> ReadHeights:
    return read_heights(
        model, frame.image, scene.background, scene.grid, mask=scene.mask,
        rest_normals=scene.rest_normals, uncertainty=uncertainty,
    )  # fmt: skip


def _rise_sigma_m(frame: PressFrame, scene: CaptureScene) -> float:
    """Standard deviation of a press's depth [m] by the radius of its circle."""
    scale = scene.grid.mm_per_px_x
    rim_mm = min(frame.circle.radius_px * scale, LARGEST_RADII * scene.ball_radius_mm)
    per_mm = deeper_per_mm(rim_mm, scene.ball_radius_mm, frame.surface.depth_mm)
    return 1e-3 * per_mm * frame.circle_sigma_px[1] * scale
