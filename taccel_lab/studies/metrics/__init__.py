# SPDX-License-Identifier: Apache-2.0
"""Figures of merit of a design; importing this package registers them all."""

from taccel_lab.studies.metrics import force, insertion, optical, shear, surface
from taccel_lab.studies.metrics.base import METRICS, Metric
from taccel_lab.studies.metrics.design_point import NoFigure

__all__ = ["METRICS", "Metric", "NoFigure", "force", "insertion", "optical", "shear", "surface"]
