# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.profile.io import Finding as Finding
from taccel_lab.profile.io import load_profile as load_profile
from taccel_lab.profile.io import require_profile_folder as require_profile_folder
from taccel_lab.profile.io import save_profile as save_profile
from taccel_lab.profile.io import split_view as split_view
from taccel_lab.profile.io import validate_profile as validate_profile
from taccel_lab.profile.optional_blocks import CoatingBlock as CoatingBlock
from taccel_lab.profile.optional_blocks import DepthResponseBlock as DepthResponseBlock
from taccel_lab.profile.optional_blocks import ForceBlock as ForceBlock
from taccel_lab.profile.optional_blocks import HousingBlock as HousingBlock
from taccel_lab.profile.optional_blocks import LightEntry as LightEntry
from taccel_lab.profile.optional_blocks import LightsBlock as LightsBlock
from taccel_lab.profile.optional_blocks import MarkersBlock as MarkersBlock
from taccel_lab.profile.optional_blocks import NormalsBlock as NormalsBlock
from taccel_lab.profile.optional_blocks import OpticsBlock as OpticsBlock
from taccel_lab.profile.optional_blocks import PerturbationBlock as PerturbationBlock
from taccel_lab.profile.optional_blocks import WindowBlock as WindowBlock
from taccel_lab.profile.schema import SCHEMA_VERSION as SCHEMA_VERSION
from taccel_lab.profile.schema import BackgroundBlock as BackgroundBlock
from taccel_lab.profile.schema import Block as Block
from taccel_lab.profile.schema import BranchEntry as BranchEntry
from taccel_lab.profile.schema import CameraBlock as CameraBlock
from taccel_lab.profile.schema import ColorBlock as ColorBlock
from taccel_lab.profile.schema import FittedWith as FittedWith
from taccel_lab.profile.schema import GelBlock as GelBlock
from taccel_lab.profile.schema import LayerMaterial as LayerMaterial
from taccel_lab.profile.schema import MaterialBlock as MaterialBlock
from taccel_lab.profile.schema import Provenance as Provenance
from taccel_lab.profile.schema import SensorBlock as SensorBlock
from taccel_lab.profile.sensor_profile import SensorProfile as SensorProfile
from taccel_lab.profile.sensor_view import MAIN_VIEW as MAIN_VIEW
from taccel_lab.profile.sensor_view import SensorView as SensorView
