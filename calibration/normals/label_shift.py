# SPDX-License-Identifier: Apache-2.0
"""How far contact circles lie from where a model that never saw their press reads them.

Inside the contact every pixel says where the ball's centre is: at ``p + R n_xy`` for a normal n.
The median over the contact is a centre by the colours of all pixels together, where a circle by
hand or by an edge rests on its rim alone. The mean shift of all presses cannot be told (moving all
circles the same way gives a model that is moved as much) and is taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.normals.ball_normals import ball_center_px
from taccel_lab.calibration.normals.samples import InverseFrame, Scene, usable_pixels
from taccel_lab.signals.normal_features import color_change
from taccel_lab.signals.normal_model import NormalModel, relative_normals, rotate_from_z

INNER_RADII = 0.9
"""Pixels within this many contact radii are asked."""
PIXEL_STRIDE = 3
MIN_PRESSES = 6
"""With fewer presses the model has learned their labels by heart."""


@dataclass(frozen=True)
class LabelShift:
    """Where the colours put a contact, relative to its circle [px]."""

    du_px: float
    dv_px: float

    @property
    def length_px(self) -> float:
        return float(np.hypot(self.du_px, self.dv_px))


def label_shifts(
    models: Sequence[NormalModel], frames: Sequence[InverseFrame], scene: Scene
) -> list[LabelShift]:
    """Shift of each press's circle, by the model given for it (one that did not see the press)."""
    shifts = []
    for model, frame in zip(models, frames, strict=True):
        shifts.append(_shift(model, frame, scene))
    mean = np.mean(shifts, axis=0)
    return [LabelShift(float(du), float(dv)) for du, dv in np.array(shifts) - mean]


def _shift(model: NormalModel, frame: InverseFrame, scene: Scene) -> np.ndarray:
    grid, circle = scene.grid, frame.circle
    change = color_change(frame.image, scene.background, scene.mask)
    inside = circle.distance_px(grid) <= INNER_RADII * circle.radius_px
    found = np.flatnonzero(inside & usable_pixels(scene))[::PIXEL_STRIDE]
    if len(found) == 0:
        return np.zeros(2)
    features = model.config.image_features(change, scene.background, mask=scene.mask)
    tilt, _ = model.predict_pixels(features.reshape(-1, model.config.input_count)[found])
    normals = relative_normals(tilt)
    if scene.rest_normals is not None:
        normals = rotate_from_z(normals, scene.rest_normals.reshape(-1, 3)[found])
    v, u = np.divmod(found, grid.width_px)
    center_u = np.median(u + normals[:, 0] * scene.ball_radius_mm / grid.mm_per_px_x)
    center_v = np.median(v + normals[:, 1] * scene.ball_radius_mm / grid.mm_per_px_y)
    given = ball_center_px(circle, grid, scene.ball_radius_mm, scene.rest_normals)
    return np.array([center_u - given[0], center_v - given[1]])
