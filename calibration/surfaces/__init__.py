# SPDX-License-Identifier: Apache-2.0
"""Gel surfaces under calibration presses: the common type and the analytic baselines."""

from calibration.surfaces.analytic import analytic_surface
from calibration.surfaces.types import PressSurface, SimulationEffort

__all__ = ["PressSurface", "SimulationEffort", "analytic_surface"]
