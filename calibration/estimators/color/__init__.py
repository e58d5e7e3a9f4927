# SPDX-License-Identifier: Apache-2.0
"""The colour model: fit, cross-validation, and circles read again with its help.

Pixels are drawn from the contact disc, the ring around it and the untouched rest. The loss is
Huber's in levels unless another is asked for.
"""

from taccel_lab.calibration.estimators.color.drift_choice import DriftChoice, choose_drift
from taccel_lab.calibration.estimators.color.fit import ColorFit, disc_l1, fit_color_model
from taccel_lab.calibration.estimators.color.folds import FoldResult, cross_validate, fold_fits
from taccel_lab.calibration.estimators.color.frames import ColorFrame
from taccel_lab.calibration.estimators.color.options import ColorFitOptions, Loss, Progress
from taccel_lab.calibration.estimators.color.registration import (
    Registration,
    RegistrationOptions,
    place_press,
    register_presses,
)

__all__ = [
    "ColorFit",
    "ColorFitOptions",
    "ColorFrame",
    "DriftChoice",
    "FoldResult",
    "Loss",
    "Progress",
    "Registration",
    "RegistrationOptions",
    "choose_drift",
    "cross_validate",
    "disc_l1",
    "fit_color_model",
    "fold_fits",
    "place_press",
    "register_presses",
]
