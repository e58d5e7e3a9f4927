# SPDX-License-Identifier: Apache-2.0
"""Held-out presses: read once by the frozen model, scored, and then ready for the last fit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet
from taccel_lab.calibration.circles.ball_surface import (
    LARGEST_RADII,
    ball_surface,
    deeper_per_mm,
)
from taccel_lab.calibration.circles.bonded_layer import BondedLayer
from taccel_lab.calibration.circles.labels import LabelPlacement
from taccel_lab.calibration.circles.usable import place_heldout
from taccel_lab.calibration.light.fit import fit_press_light
from taccel_lab.calibration.normals.reading_error import KnownPress, ReadingErrors, errors_of
from taccel_lab.calibration.normals.samples import (
    CaptureScene,
    CircleSigma,
    InverseFrame,
    circle_angle_rad,
    true_normals,
)
from taccel_lab.calibration.normals.score import HeldoutNormals, inside_of, score_heldout
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.read_heights import read_heights
from taccel_lab.signals.rest_surface import RestSurface

READING = "reading the held-out presses"


def in_background_light(image: np.ndarray, scene: CaptureScene) -> np.ndarray:
    """A frame in the light of the background, as the model will bring new ones to it."""
    light = fit_press_light(image, scene.background, scene.mask)
    return light.remove(image).astype(np.float32)


@dataclass
class HeldoutReading:
    """Presses that nothing had seen, as the frozen model reads them."""

    model: NormalModel
    captures: CaptureSet
    """The held-out presses alone."""
    labels: LabelPlacement
    """Where their labels put them."""
    scene: CaptureScene
    rest: RestSurface
    pad: BondedLayer | None
    circle_sigma_px: CircleSigma
    """Of the circles of training presses."""
    items: list[HeldoutNormals] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    """Presses that could not be read, and why."""
    errors: list[ReadingErrors] = field(default_factory=list)
    """Of presses whose labels their images do not reject."""

    def run(self, training: CaptureSet, progress: Progress) -> None:
        """Place each press by its label, read it and score it."""
        count = len(self.captures.presses)
        for done, press in enumerate(self.captures.presses, 1):
            try:
                self._read(press, training)
            except InputError as error:
                self.failures[press.name] = str(error)
            progress(READING, done, count)

    def _read(self, press: CapturedPress, training: CaptureSet) -> None:
        scene, pad, captures = self.scene, self.pad, self.captures
        captured = press.image().astype(np.float32)
        circle = place_heldout(press, captured, training, self.labels)
        image = in_background_light(captured, scene)
        own_px = self.circle_sigma_px
        sigma_px = own_px if press.circle is None else self.labels.sigma_px(own_px)
        surface = None
        if pad is not None:
            ball_mm = press.radius_mm or captures.ball_radius_mm
            surface = ball_surface(circle, ball_mm, captures.grid, pad, self.rest)
        frame = InverseFrame(press.name, image, circle, press.sha256, surface, sigma_px)
        read = read_heights(
            self.model, image, scene.background, scene.grid, mask=scene.mask,
            rest_normals=scene.rest_normals,
        )  # fmt: skip
        wanted_mm = None if surface is None else surface.displacement_mm()
        self.items.append(
            score_heldout(read, frame, press.circle, scene, wanted_mm, rejected=press.mislabelled)
        )
        if press.mislabelled:
            return
        found = errors_of(self.model, _known(scene, frame), scene, read)
        self.errors += [] if found is None else [found]

    def joining(self) -> list[InverseFrame]:
        """The presses as the last fit takes them, where they were read. One that is read no better
        than by a flat guess shows something else."""
        return [i.frame for i in self.items if i.used.mean_deg < i.used.flat_deg]


def _known(scene: CaptureScene, frame: InverseFrame) -> KnownPress:
    """A press in the circle that its label gives it."""
    scale, surface = scene.grid.mm_per_px_x, frame.surface
    normals = true_normals(replace(frame, surface=None), scene)
    known = KnownPress(
        image=frame.image,
        normals=normals,
        rise_m=None,
        compared=inside_of(frame.circle, scene),
        normals_sigma_deg=np.degrees(circle_angle_rad(frame, scene, normals)),
    )
    if surface is None:
        return known
    rim_mm = min(frame.circle.radius_px * scale, LARGEST_RADII * scene.ball_radius_mm)
    per_mm = deeper_per_mm(rim_mm, scene.ball_radius_mm, surface.depth_mm)
    return replace(
        known,
        rise_m=1e-3 * surface.displacement_mm(),
        rise_sigma_m=1e-3 * per_mm * frame.circle_sigma_px[1] * scale,
    )
