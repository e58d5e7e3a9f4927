# SPDX-License-Identifier: Apache-2.0
"""Figures of merit of a design, one concept a file; importing this package registers them all."""

from taccel_lab.studies.metrics import (
    bond_stress,
    contact_area,
    edge_sharpness,
    force_curve,
    force_range,
    gel,
    hysteresis,
    insertion,
    optical,
    sensitivity,
    shear_response,
    stiffness,
    two_point,
    uniformity,
)
from taccel_lab.studies.metrics.base import METRICS, Metric, NoFigure

__all__ = [
    "METRICS",
    "Metric",
    "NoFigure",
    "bond_stress",
    "contact_area",
    "edge_sharpness",
    "force_curve",
    "force_range",
    "gel",
    "hysteresis",
    "insertion",
    "optical",
    "sensitivity",
    "shear_response",
    "stiffness",
    "two_point",
    "uniformity",
]
