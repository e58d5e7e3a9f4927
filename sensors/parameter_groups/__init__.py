# SPDX-License-Identifier: Apache-2.0
"""Parameters that most sensors share, one dataclass a part: image, camera, lights, window, gel.

A family inherits them through ``sensors.camera_sensor`` and restates what is special about it
(``cad.parameters.restated``), with its source. The defaults here stand where no source says
anything about a sensor, and say so.
"""

from sensors.parameter_groups.camera import CameraParameters, FisheyeParameters
from sensors.parameter_groups.coating import CoatingParameters
from sensors.parameter_groups.gel import RectangleGelParameters
from sensors.parameter_groups.housing import HousingParameters
from sensors.parameter_groups.lights import LightParameters
from sensors.parameter_groups.markers import MarkerParameters
from sensors.parameter_groups.material import MaterialParameters, SkinParameters
from sensors.parameter_groups.window import WindowParameters

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
