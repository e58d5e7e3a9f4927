# SPDX-License-Identifier: Apache-2.0
"""Figures of the camera's picture of the untouched gel; see ``taccel_lab.optics.photometry``."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.design_point import NoFigure
from taccel_lab.studies.metrics.evidence import VIEW_PX, Evidence


@metric(
    "optical_uniformity", "1",
    "darkest over mean of the picture of the untouched gel, in its worst channel with light",
    "higher", (),
)  # fmt: skip
def optical_uniformity(evidence: Evidence) -> float:
    """Least of the channels."""
    return float(np.nanmin(evidence.photometry.uniformity_min_over_mean))


@metric(
    "optical_condition", "1",
    "condition number of the channels' light directions, median over the gel: how well a colour "
    "tells one slope from another, 1 is best", "lower", (),
)  # fmt: skip
def optical_condition(evidence: Evidence) -> float:
    """None for lights that do not span space."""
    figures = evidence.photometry
    if figures.condition_number is None:
        raise NoFigure(
            f"the lights span {figures.light_rank} of 3 directions: there is no condition number"
        )
    return figures.condition_number.median


@metric(
    "optical_slope", "levels/deg",
    "grey levels per degree of tilt, in the direction of tilt that changes the picture least",
    "higher", (),
)  # fmt: skip
def optical_slope(evidence: Evidence) -> float:
    """Median over the gel."""
    return evidence.photometry.weakest_levels_per_deg


@metric(
    "visible_fraction", "1", "part of the contact face that the camera sees", "higher", (),
)  # fmt: skip
def visible_fraction(evidence: Evidence) -> float:
    """Area seen over the whole area."""
    return evidence.photometry.visible_fraction


@metric(
    "pixel_size", "mm/px", "size of a pixel of the camera on the contact face, median", "lower",
    (),
)  # fmt: skip
def pixel_size(evidence: Evidence) -> float:
    """Geometric mean of both directions, at the camera's own resolution."""
    figures, design = evidence.photometry, evidence.parameters.optics()
    assert design is not None
    longer = max(design.camera.width_px, design.camera.height_px)
    mean = math.sqrt(figures.mm_per_px_x.median * figures.mm_per_px_y.median)
    return mean * min(1.0, VIEW_PX / longer)


@metric(
    "px_per_mm", "px/mm", "pixels of the tactile image on a millimetre of the gel, mean of both "
    "axes", "higher", (),
)  # fmt: skip
def px_per_mm(evidence: Evidence) -> float:
    """Counts pixels of the image as the sensor gives it, not the camera's own."""
    return 1 / evidence.mm_per_px


@metric(
    "depth_of_field", "mm", "range of heights in the gel that the camera shows sharp to one pixel",
    "higher", (),
)  # fmt: skip
def depth_of_field(evidence: Evidence) -> float:
    """Follows from the camera's own pixels; None while aperture or focus are unknown."""
    from taccel_lab.optics.photometry import sharp_range_mm

    design = evidence.parameters.optics()
    if design is None:
        raise NoFigure("the family has no optical model")
    camera = design.camera
    if not (camera.aperture_mm > 0 and camera.focus_mm > 0):
        raise NoFigure("the camera's aperture or focus is unknown")
    focal = 0.5 * (camera.fx_px + camera.fy_px)
    near, far = sharp_range_mm(focal, camera.aperture_mm, camera.focus_mm)
    return (far - near) * design.gel_refractive_index


@metric(
    "shadowed_fraction", "1", "part of the light on the untouched gel that the gel itself blocks",
    "lower", (),
)  # fmt: skip
def shadowed_fraction(evidence: Evidence) -> float:
    """Takes all channels together."""
    return evidence.photometry.shadowed_fraction
