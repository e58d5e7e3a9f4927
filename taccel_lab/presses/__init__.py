# SPDX-License-Identifier: Apache-2.0
"""Ready-made experiments on a sensor: what happens, not what is measured or drawn."""

from taccel_lab.presses.fitted_physics import physics_difference
from taccel_lab.presses.indenter import Indenter, parse_indenter
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressMeshOptions, PressPhysics
from taccel_lab.presses.press import PressEnv
from taccel_lab.presses.press_force import press_to_force
from taccel_lab.presses.press_frame import normal_frame
from taccel_lab.presses.press_outcome import PressOutcome, PressStep, simulate_press
from taccel_lab.presses.press_path import PressPath
from taccel_lab.scene.profile_gel import layered_material, profile_material

__all__ = [
    "PHYSICS",
    "Accuracy",
    "Indenter",
    "PressEnv",
    "PressMeshOptions",
    "PressOutcome",
    "PressPath",
    "PressPhysics",
    "PressStep",
    "layered_material",
    "normal_frame",
    "parse_indenter",
    "physics_difference",
    "press_to_force",
    "profile_material",
    "simulate_press",
]
