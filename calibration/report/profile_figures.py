# SPDX-License-Identifier: Apache-2.0
"""Pictures of a profile."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.profile import SensorProfile
from taccel_lab.report.style import BLUE, ORANGE, in_report_style, new_figure
from taccel_lab.signals.perturbation import draw_perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRAWS = 6


@in_report_style
def draw_depth_response(profile: SensorProfile) -> Figure:
    """Drop of the grey level against indentation, with the stated spread as a band."""
    block = profile.depth_response
    assert block is not None
    drop, depth = np.array(block.drop_levels), np.array(block.depth_mm)
    figure, axes = new_figure(6.4, 3.6)
    axes.grid(True)
    axes.plot(drop, depth, color=BLUE)
    sigma = block.provenance.spread.get("depth_mm")
    if sigma is not None:
        axes.fill_between(
            drop, depth - sigma, depth + sigma, color=ORANGE, alpha=0.25, linewidth=0,
            label="± 1 standard deviation",
        )  # fmt: skip
        axes.legend()
    axes.set_xlabel(f"background minus image, {block.channel} [levels]")
    axes.set_ylabel("indentation [mm]")
    return figure


@in_report_style
def draw_perturbed(profile: SensorProfile) -> Figure:
    """The image at rest of a few drawn sensors."""
    image, block = profile.background_rgb, profile.perturbation
    assert image is not None and block is not None
    rng = np.random.default_rng(0)
    sensors = PerturbedSensors(draw_perturbation(block, DRAWS, rng))
    images = sensors.apply(np.repeat(image[None].astype(np.float32), DRAWS, axis=0), rng)
    ratio = image.shape[0] / image.shape[1]
    figure, axes = new_figure(9.0, 6.0 * ratio + 0.4, 2, 3)
    for panel, drawn in zip(axes.ravel(), images, strict=True):
        panel.imshow(drawn.astype(np.uint8))
        panel.set_axis_off()
    return figure
