# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture``: everything before a fit."""

from __future__ import annotations

from typing import Any

HELP = "Plan, import, check, review and rectify captures."


def capture_commands() -> Any:
    """The sub-commands; imported here so that help is fast."""
    from tyro.extras import SubcommandApp

    from taccel_lab.cli.capture.check import CaptureCheckCommand
    from taccel_lab.cli.capture.guide import CaptureGuide
    from taccel_lab.cli.capture.import_ import CaptureImport
    from taccel_lab.cli.capture.rectify import CaptureRectify
    from taccel_lab.cli.capture.review import CaptureReview

    app = SubcommandApp()
    app.command(name="check")(CaptureCheckCommand)
    app.command(name="guide")(CaptureGuide)
    app.command(name="import")(CaptureImport)
    app.command(name="review")(CaptureReview)
    app.command(name="rectify")(CaptureRectify)
    return app
