# SPDX-License-Identifier: Apache-2.0
"""The image of the untouched sensor: drift of the light, noise, dust, and how far they spread."""

from taccel_lab.calibration.background.average import average_background
from taccel_lab.calibration.background.drift import Drift, fit_drift, fit_robust_drift, remove_drift

__all__ = ["Drift", "average_background", "fit_drift", "fit_robust_drift", "remove_drift"]
