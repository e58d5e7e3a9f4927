# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: one command for each block, and all of them at once."""

from __future__ import annotations

from typing import Any


def calibrate_commands() -> dict[str, Any]:
    """The sub-commands by name; imported here so that help is fast."""
    from taccel_lab.cli.calibrate import blocks
    from taccel_lab.cli.calibrate.all import CalibrateAll
    from taccel_lab.cli.calibrate.force import CalibrateForce
    from taccel_lab.cli.calibrate.refit import CalibrateRefit

    return {
        "all": CalibrateAll,
        "background": blocks.CalibrateBackground,
        "camera": blocks.CalibrateCamera,
        "color": blocks.CalibrateColor,
        "depth": blocks.CalibrateDepth,
        "force": CalibrateForce,
        "markers": blocks.CalibrateMarkers,
        "material": blocks.CalibrateMaterial,
        "normals": blocks.CalibrateNormals,
        "scale": blocks.CalibrateScale,
        "refit": CalibrateRefit,
        "spread": blocks.CalibrateSpread,
    }
