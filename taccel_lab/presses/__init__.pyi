# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.presses.env import PressEnv as PressEnv
from taccel_lab.presses.force_search import press_to_force as press_to_force
from taccel_lab.presses.frame import normal_frame as normal_frame
from taccel_lab.presses.indenter import Indenter as Indenter
from taccel_lab.presses.indenter import parse_indenter as parse_indenter
from taccel_lab.presses.outcome import PressOutcome as PressOutcome
from taccel_lab.presses.outcome import PressStep as PressStep
from taccel_lab.presses.outcome import SeenFrom as SeenFrom
from taccel_lab.presses.outcome import simulate_press as simulate_press
from taccel_lab.presses.path import PressPath as PressPath
from taccel_lab.presses.physics import PHYSICS as PHYSICS
from taccel_lab.presses.physics import Accuracy as Accuracy
from taccel_lab.presses.physics import PressMeshOptions as PressMeshOptions
from taccel_lab.presses.physics import PressPhysics as PressPhysics
from taccel_lab.presses.physics import physics_difference as physics_difference
from taccel_lab.presses.profile_gel import layered_material as layered_material
from taccel_lab.presses.profile_gel import profile_material as profile_material
from taccel_lab.presses.profile_gel import profile_scene as profile_scene
from taccel_lab.presses.setup import PressSetup as PressSetup
