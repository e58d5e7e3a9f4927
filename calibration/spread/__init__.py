# SPDX-License-Identifier: Apache-2.0
"""How far units and days differ: the profile's ``perturbation`` block from measured spread."""

from taccel_lab.calibration.spread.fit import SpreadCalibration, calibrate_spread
from taccel_lab.calibration.spread.units import UnitSpread, spread_of_units

__all__ = ["SpreadCalibration", "UnitSpread", "calibrate_spread", "spread_of_units"]
