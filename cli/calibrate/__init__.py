# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: one command for each block, and all of them at once."""

from __future__ import annotations

from typing import Any


def calibrate_commands() -> dict[str, Any]:
    """The sub-commands by name; imported here so that help is fast."""
    from taccel_lab.cli.calibrate.all import CalibrateAll
    from taccel_lab.cli.calibrate.background import CalibrateBackground
    from taccel_lab.cli.calibrate.camera import CalibrateCamera
    from taccel_lab.cli.calibrate.color import CalibrateColor
    from taccel_lab.cli.calibrate.depth import CalibrateDepth
    from taccel_lab.cli.calibrate.force import CalibrateForce
    from taccel_lab.cli.calibrate.markers import CalibrateMarkers
    from taccel_lab.cli.calibrate.material import CalibrateMaterial
    from taccel_lab.cli.calibrate.normals import CalibrateNormals
    from taccel_lab.cli.calibrate.refit import CalibrateRefit
    from taccel_lab.cli.calibrate.scale import CalibrateScale
    from taccel_lab.cli.calibrate.spread import CalibrateSpread

    return {
        "all": CalibrateAll,
        "background": CalibrateBackground,
        "camera": CalibrateCamera,
        "color": CalibrateColor,
        "depth": CalibrateDepth,
        "force": CalibrateForce,
        "markers": CalibrateMarkers,
        "material": CalibrateMaterial,
        "normals": CalibrateNormals,
        "scale": CalibrateScale,
        "refit": CalibrateRefit,
        "spread": CalibrateSpread,
    }
