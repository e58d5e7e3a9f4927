# SPDX-License-Identifier: Apache-2.0
"""What a colour model answers to every normal at a few places of the image."""

from __future__ import annotations

import numpy as np

from taccel_lab.profile import SensorProfile
from taccel_lab.report.figures_color import disc_normals
from taccel_lab.report.model import NormalDisc
from taccel_lab.signals.color_model import ColorModel

PLACES = ((0.5, 0.5), (0.2, 0.25), (0.8, 0.25), (0.2, 0.75), (0.8, 0.75))
"""Shares of the image's width and height: the middle and near the corners."""
DISC_SIZE = 65
SPAN = 0.7
"""Largest sine of the tilt at which colours are compared: 44 degrees."""
DISPLACEMENT_MM = -0.3
"""Indentation at which they are compared [mm]."""


def color_discs(
    model: ColorModel,
    span: float,
    displacement_mm: float,
    *,
    rest_normals: np.ndarray | None = None,
    trained_sine: float | None = None,
) -> tuple[NormalDisc, ...]:
    """Colour change over the hemisphere of normals at ``PLACES``.

    Args:
        model: Colour model.
        span: Largest sine of the tilt.
        displacement_mm: Rise of the face over rest that goes with it [mm].
        rest_normals: Of the untouched face, shape [height_px, width_px, 3]; flat if missing.
        trained_sine: Largest sine of the tilt that the model was fitted to.
    """
    normals = disc_normals(DISC_SIZE, span)
    seen = np.isfinite(normals[..., 0])
    count = int(seen.sum())
    width, height = model.config.width_px, model.config.height_px
    discs = []
    for share_u, share_v in PLACES:
        u, v = round(share_u * (width - 1)), round(share_v * (height - 1))
        rest = np.array([0.0, 0.0, 1.0]) if rest_normals is None else rest_normals[v, u]
        delta = np.full((*seen.shape, 3), np.nan)
        delta[seen] = model.predict_pixels(
            np.full(count, v * width + u),
            normals[seen],
            np.full(count, displacement_mm),
            np.broadcast_to(rest, (count, 3)),
        )
        discs.append(NormalDisc((u, v), delta, span, trained_sine))
    return tuple(discs)


def profile_discs(profile: SensorProfile) -> tuple[NormalDisc, ...]:
    """Colour change over the hemisphere of normals; empty without a colour model."""
    model = ColorModel.from_profile(profile)
    return () if model is None else color_discs(model, SPAN, DISPLACEMENT_MM)
