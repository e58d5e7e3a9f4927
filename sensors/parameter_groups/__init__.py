# SPDX-License-Identifier: Apache-2.0
"""Parameters that most sensors share, one dataclass a part: image, camera, lights, window, gel.

A family inherits them through ``taccel_lab.sensors.camera_sensor`` and restates what is special
about it (``taccel_lab.cad.parameters.restated``), with its source. The defaults here stand where no
source says anything about a sensor, and say so.
"""

from taccel_lab.sensors.parameter_groups.camera import CameraParameters, FisheyeParameters
from taccel_lab.sensors.parameter_groups.coating import CoatingParameters
from taccel_lab.sensors.parameter_groups.gel import RectangleGelParameters
from taccel_lab.sensors.parameter_groups.housing import HousingParameters
from taccel_lab.sensors.parameter_groups.lights import LightParameters
from taccel_lab.sensors.parameter_groups.markers import MarkerParameters
from taccel_lab.sensors.parameter_groups.material import MaterialParameters, SkinParameters
from taccel_lab.sensors.parameter_groups.window import WindowParameters

__all__ = [
    "CameraParameters",
    "CoatingParameters",
    "FisheyeParameters",
    "HousingParameters",
    "LightParameters",
    "MarkerParameters",
    "MaterialParameters",
    "RectangleGelParameters",
    "SkinParameters",
    "WindowParameters",
]
