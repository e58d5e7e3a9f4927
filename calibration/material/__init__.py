# SPDX-License-Identifier: Apache-2.0
"""The gel's material from forces and motions: stiffness, Poisson's ratio, friction, damping."""

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
from calibration.material.setup import EFFORTS, Effort, Gel, Tool
from calibration.material.sliding import SlideFit, fit_slide
from calibration.material.tangential import TangentialFit, fit_tangential

__all__ = [
    "EFFORTS",
    "DampingFit",
    "Effort",
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
