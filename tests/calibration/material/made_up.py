# SPDX-License-Identifier: Apache-2.0
"""Records and tables made up in memory, and physics that is quicker than any that a user gets."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import NU_RANGE, ForceTable, TableError
from taccel_lab.calibration.material.gel import CurveTool, Gel, IndentationPoints
from taccel_lab.presses.bonded_layer import ToolKind, layer_force_n
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics
from taccel_lab.sensors.profile import catalogue_profile

COARSE = PressPhysics(mesh=PressMeshOptions(elements_per_radius=2.0, core=4, rings=6))
"""2,325 nodes of a GelSight Mini; tables take the error of their mesh from presses of ``FAST``."""
COARSER = PressPhysics(mesh=PressMeshOptions(elements_per_radius=1.5, core=4, rings=4))
"""Where only the way matters, not the force."""
COARSE_FAST = PressPhysics(Accuracy.FAST, mesh=COARSER.mesh)
"""The same under the name of the fast physics."""
FAST, DEFAULT = PHYSICS[Accuracy.FAST], PHYSICS[Accuracy.DEFAULT]
THICKNESS_MM = 4.0


@cache
def gel() -> Gel:
    """Of a GelSight Mini."""
    return Gel.of_profile(catalogue_profile("gelsight_mini"))


def ball(radius_mm: float) -> CurveTool:
    return gel().tool(ToolEntry(kind="sphere", radius_mm=radius_mm))


@cache
def layer_table(kind: ToolKind, radius_mm: float) -> ForceTable:
    """Of a ball or punch on a layer that is bonded to its base, of any Poisson's ratio."""
    s = np.sqrt(1 - 2 * np.array(NU_RANGE))
    nu = 0.5 * (1 - (s.mean() + 0.5 * np.ptp(s) * chebpts1(5))[::-1] ** 2)
    exponent = 1.5 if kind == "sphere" else 1.0
    depths = 0.1 + 1.5 * np.linspace(0, 1, 7) ** 1.4
    force = [layer_force_n(kind, depths, radius_mm, THICKNESS_MM, each) for each in nu.tolist()]
    log = np.log(force) - exponent * np.log(depths)
    return ForceTable(exponent, nu, depths, log, TableError(0.0, np.full(7, 0.003)), NU_RANGE)


def points(
    tool: CurveTool, depth: np.ndarray, force: np.ndarray, sigma: np.ndarray | None = None
) -> IndentationPoints:
    """Readings of one press."""
    return IndentationPoints("press", "press.csv", "0" * 64, tool, depth, force, sigma)
