# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: one command for each block, and all of them at once."""

from __future__ import annotations

from typing import Any

HELP = "Fit the blocks of a profile to real captures."


def calibrate_commands() -> Any:
    """The sub-commands; imported here so that help is fast."""
    from tyro.extras import SubcommandApp

    from taccel_lab.cli.calibrate.all import CalibrateAll
    from taccel_lab.cli.calibrate.background import CalibrateBackground
    from taccel_lab.cli.calibrate.camera import CalibrateCamera
    from taccel_lab.cli.calibrate.color import CalibrateColor
    from taccel_lab.cli.calibrate.depth import CalibrateDepth
    from taccel_lab.cli.calibrate.markers import CalibrateMarkers
    from taccel_lab.cli.calibrate.material import CalibrateMaterial
    from taccel_lab.cli.calibrate.normals import CalibrateNormals
    from taccel_lab.cli.calibrate.refit import CalibrateRefit
    from taccel_lab.cli.calibrate.scale import CalibrateScale
    from taccel_lab.cli.calibrate.spread import CalibrateSpread

    app = SubcommandApp()
    app.command(name="all")(CalibrateAll)
    app.command(name="background")(CalibrateBackground)
    app.command(name="camera")(CalibrateCamera)
    app.command(name="color")(CalibrateColor)
    app.command(name="depth")(CalibrateDepth)
    app.command(name="markers")(CalibrateMarkers)
    app.command(name="material")(CalibrateMaterial)
    app.command(name="normals")(CalibrateNormals)
    app.command(name="scale")(CalibrateScale)
    app.command(name="refit")(CalibrateRefit)
    app.command(name="spread")(CalibrateSpread)
    return app
