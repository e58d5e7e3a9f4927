# SPDX-License-Identifier: Apache-2.0
"""Gel surfaces under calibration presses."""

from taccel_lab.calibration.surfaces.press_surface import BallSurface

__all__ = ["BallSurface"]
