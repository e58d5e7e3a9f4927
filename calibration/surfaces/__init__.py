# SPDX-License-Identifier: Apache-2.0
"""Gel surfaces under calibration presses: the common type and the analytic baselines."""

from taccel_lab.calibration.surfaces.analytic import analytic_surface
from taccel_lab.calibration.surfaces.press_surface import PressSurface, SimulationEffort

__all__ = ["PressSurface", "SimulationEffort", "analytic_surface"]
