# SPDX-License-Identifier: Apache-2.0
"""Ready-made experiments on a sensor: what happens, not what is measured or drawn."""

from taccel_lab.envs.indenter import Indenter, parse_indenter
from taccel_lab.envs.press import PressEnv, PressPath
from taccel_lab.envs.press_outcome import PressOutcome, PressStep, simulate_press

__all__ = [
    "Indenter",
    "PressEnv",
    "PressOutcome",
    "PressPath",
    "PressStep",
    "parse_indenter",
    "simulate_press",
]
