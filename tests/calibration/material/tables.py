# SPDX-License-Identifier: Apache-2.0
"""Force tables without simulations, from the closed forms of bonded layers."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.material.force_table import NU_RANGE, ForceTable, TableError
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.envs.bonded_layer import ToolKind, layer_force_n

THICKNESS_MM = 4.0


def layer_table(kind: ToolKind, radius_mm: float, deepest_mm: float = 1.6) -> ForceTable:
    """Of a ball or punch on a layer that is bonded to its base, of any Poisson's ratio."""
    axis = Axis(*NU_RANGE, "compressibility")
    exponent = 1.5 if kind == "sphere" else 1.0
    depths = 0.1 + (deepest_mm - 0.1) * np.linspace(0, 1, 7) ** 1.4
    log = [
        np.log(layer_force_n(kind, depths, radius_mm, THICKNESS_MM, float(nu)))
        - exponent * np.log(depths)
        for nu in axis.nodes(5)
    ]
    responses = ResponseTable.through(Axis(0.0, 0.0), axis, np.log(depths), np.array(log)[None])
    return ForceTable(exponent, responses, TableError(0.0, np.full(7, 0.003)))
