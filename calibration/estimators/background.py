# SPDX-License-Identifier: Apache-2.0
"""Background of the colour estimator; the family lives in ``calibration.background``."""

from calibration.background.average import average_background
from calibration.background.drift import Drift, fit_drift

__all__ = ["Drift", "average_background", "fit_drift"]
