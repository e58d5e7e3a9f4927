# SPDX-License-Identifier: Apache-2.0
"""The gel's material from forces and motions: stiffness, Poisson's ratio, friction, damping.

The names below load their modules on first use (PEP 562): presses alone need neither NLopt nor the
readers of captures and profiles.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibration.material.bonded_layer import (
        fast_young_modulus_pa,
        layer_force_n,
        sphere_force_series_n,
    )
    from calibration.material.calibrate import calibrate_material
    from calibration.material.calibration import MaterialCalibration
    from calibration.material.flow import FlowFit, fit_flow
    from calibration.material.flow_table import ToolPath
    from calibration.material.indentation import IndentationFit, fit_indentation
    from calibration.material.options import MaterialOptions
    from calibration.material.page import material_page
    from calibration.material.points import IndentationPoints, points_of_record
    from calibration.material.relaxation import DampingFit, fit_damping
    from calibration.material.response import ForceTable, force_table
    from calibration.material.setup import Gel, Tool
    from calibration.material.sliding import SlideFit, fit_slide
    from calibration.material.tangential import TangentialFit, fit_tangential

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
    "DampingFit": "calibration.material.relaxation",
    "FlowFit": "calibration.material.flow",
    "ForceTable": "calibration.material.response",
    "Gel": "calibration.material.setup",
    "IndentationFit": "calibration.material.indentation",
    "IndentationPoints": "calibration.material.points",
    "MaterialCalibration": "calibration.material.calibration",
    "MaterialOptions": "calibration.material.options",
    "SlideFit": "calibration.material.sliding",
    "TangentialFit": "calibration.material.tangential",
    "Tool": "calibration.material.setup",
    "ToolPath": "calibration.material.flow_table",
    "calibrate_material": "calibration.material.calibrate",
    "fast_young_modulus_pa": "calibration.material.bonded_layer",
    "fit_damping": "calibration.material.relaxation",
    "fit_flow": "calibration.material.flow",
    "fit_indentation": "calibration.material.indentation",
    "fit_slide": "calibration.material.sliding",
    "fit_tangential": "calibration.material.tangential",
    "force_table": "calibration.material.response",
    "layer_force_n": "calibration.material.bonded_layer",
    "material_page": "calibration.material.page",
    "points_of_record": "calibration.material.points",
    "sphere_force_series_n": "calibration.material.bonded_layer",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'calibration.material' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
