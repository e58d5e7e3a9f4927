# SPDX-License-Identifier: Apache-2.0
"""Camera, lights and what a sensor would look like before it is built."""

from taccel_lab.profile.optical_design import (
    Coating,
    DesignedCamera,
    Light,
    MarkerGrid,
    OpticalDesign,
    Window,
)

__all__ = ["Coating", "DesignedCamera", "Light", "MarkerGrid", "OpticalDesign", "Window"]
