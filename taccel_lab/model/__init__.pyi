# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.model.build import build_model as build_model
from taccel_lab.model.model import AffineArrays as AffineArrays
from taccel_lab.model.model import BodyKind as BodyKind
from taccel_lab.model.model import BodyRange as BodyRange
from taccel_lab.model.model import Model as Model
from taccel_lab.model.model import RigidTarget as RigidTarget
