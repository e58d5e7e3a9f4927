# SPDX-License-Identifier: Apache-2.0
"""Records and tables made up in memory, and physics that is quicker than any that a user gets."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.chebyshev import chebpts1

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import RecordEntry, ToolEntry
from taccel_lab.calibration.material.force_table import NU_RANGE, ForceTable, TableError
from taccel_lab.calibration.material.gel import CurveTool, IndentationPoints
from taccel_lab.presses.bonded_layer import ToolKind, layer_force_n
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics

_MESH = PressMeshOptions(elements_per_radius=2.0, core=4, rings=6)
"""2,325 nodes of a GelSight Mini."""
COARSE = PressPhysics(mesh=_MESH)
"""Tables take the error of their mesh from presses of ``FAST``."""
COARSER = PressPhysics(mesh=PressMeshOptions(elements_per_radius=1.5, core=4, rings=4))
"""Where only the way matters, not the force."""
COARSE_FAST = PressPhysics(Accuracy.FAST, mesh=COARSER.mesh)
"""The same under the name of the fast physics."""
FAST = PHYSICS[Accuracy.FAST]
DEFAULT = PHYSICS[Accuracy.DEFAULT]


def record(
    kind: str, radius_mm: float = 4.0, sigma_n: float | None = None, **columns
) -> ForceRecord:
    """A record of a ball."""
    entry = RecordEntry(
        file="a.csv",
        kind=kind,  # type: ignore[arg-type]
        tool=ToolEntry(kind="sphere", radius_mm=radius_mm),
        force_sigma_n=sigma_n,
    )
    arrays = {name: np.asarray(values, dtype=float) for name, values in columns.items()}
    return ForceRecord(entry, "folder/a.csv", "0" * 64, arrays)


THICKNESS_MM = 4.0


def layer_table(kind: ToolKind, radius_mm: float, deepest_mm: float = 1.6) -> ForceTable:
    """Of a ball or punch on a layer that is bonded to its base, of any Poisson's ratio."""
    s = np.sqrt(1 - 2 * np.array(NU_RANGE))
    nu = 0.5 * (1 - (s.mean() + 0.5 * np.ptp(s) * chebpts1(5))[::-1] ** 2)
    exponent = 1.5 if kind == "sphere" else 1.0
    depths = 0.1 + (deepest_mm - 0.1) * np.linspace(0, 1, 7) ** 1.4
    log = [
        np.log(layer_force_n(kind, depths, radius_mm, THICKNESS_MM, each))
        - exponent * np.log(depths)
        for each in nu.tolist()
    ]
    error = TableError(0.0, np.full(7, 0.003))
    return ForceTable(exponent, nu, depths, np.array(log), error, NU_RANGE)


def points(
    tool: CurveTool, depth: np.ndarray, force: np.ndarray, sigma: np.ndarray | None = None
) -> IndentationPoints:
    """Readings of one press."""
    return IndentationPoints("press", "press.csv", "0" * 64, tool, depth, force, sigma)
