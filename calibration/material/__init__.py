# SPDX-License-Identifier: Apache-2.0
"""The gel's material from forces and motions: stiffness, Poisson's ratio, friction, damping.

The names below load their modules on first use (PEP 562): presses alone need neither NLopt nor the
readers of captures and profiles.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from taccel_lab.calibration.material.bonded_layer import (
        fast_young_modulus_pa,
        layer_force_n,
        sphere_force_series_n,
    )
    from taccel_lab.calibration.material.fit import calibrate_material
    from taccel_lab.calibration.material.flow import FlowFit, fit_flow
    from taccel_lab.calibration.material.flow_table import ToolPath
    from taccel_lab.calibration.material.indentation import IndentationFit, fit_indentation
    from taccel_lab.calibration.material.options import MaterialOptions
    from taccel_lab.calibration.material.points import IndentationPoints, points_of_record
    from taccel_lab.calibration.material.relaxation import DampingFit, fit_damping
    from taccel_lab.calibration.material.report import material_page
    from taccel_lab.calibration.material.response import ForceTable, force_table
    from taccel_lab.calibration.material.result import MaterialCalibration
    from taccel_lab.calibration.material.setup import Gel, Tool
    from taccel_lab.calibration.material.sliding import SlideFit, fit_slide
    from taccel_lab.calibration.material.tangential import TangentialFit, fit_tangential

__all__ = [
    "DampingFit",
    "FlowFit",
    "ForceTable",
    "Gel",
    "IndentationFit",
    "IndentationPoints",
    "MaterialCalibration",
    "MaterialOptions",
    "SlideFit",
    "TangentialFit",
    "Tool",
    "ToolPath",
    "calibrate_material",
    "fast_young_modulus_pa",
    "fit_damping",
    "fit_flow",
    "fit_indentation",
    "fit_slide",
    "fit_tangential",
    "force_table",
    "layer_force_n",
    "material_page",
    "points_of_record",
    "sphere_force_series_n",
]

_HOME = {
    "DampingFit": "taccel_lab.calibration.material.relaxation",
    "FlowFit": "taccel_lab.calibration.material.flow",
    "ForceTable": "taccel_lab.calibration.material.response",
    "Gel": "taccel_lab.calibration.material.setup",
    "IndentationFit": "taccel_lab.calibration.material.indentation",
    "IndentationPoints": "taccel_lab.calibration.material.points",
    "MaterialCalibration": "taccel_lab.calibration.material.result",
    "MaterialOptions": "taccel_lab.calibration.material.options",
    "SlideFit": "taccel_lab.calibration.material.sliding",
    "TangentialFit": "taccel_lab.calibration.material.tangential",
    "Tool": "taccel_lab.calibration.material.setup",
    "ToolPath": "taccel_lab.calibration.material.flow_table",
    "calibrate_material": "taccel_lab.calibration.material.fit",
    "fast_young_modulus_pa": "taccel_lab.calibration.material.bonded_layer",
    "fit_damping": "taccel_lab.calibration.material.relaxation",
    "fit_flow": "taccel_lab.calibration.material.flow",
    "fit_indentation": "taccel_lab.calibration.material.indentation",
    "fit_slide": "taccel_lab.calibration.material.sliding",
    "fit_tangential": "taccel_lab.calibration.material.tangential",
    "force_table": "taccel_lab.calibration.material.response",
    "layer_force_n": "taccel_lab.calibration.material.bonded_layer",
    "material_page": "taccel_lab.calibration.material.report",
    "points_of_record": "taccel_lab.calibration.material.points",
    "sphere_force_series_n": "taccel_lab.calibration.material.bonded_layer",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'taccel_lab.calibration.material' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
