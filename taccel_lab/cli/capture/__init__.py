# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture``: everything before a fit."""

from __future__ import annotations

from typing import Any


def capture_commands() -> dict[str, Any]:
    """The sub-commands by name; imported here so that help is fast."""
    from taccel_lab.cli.capture.check import CaptureCheckCommand
    from taccel_lab.cli.capture.devices import CaptureDevices
    from taccel_lab.cli.capture.guide import CaptureGuide
    from taccel_lab.cli.capture.import_ import CaptureImport
    from taccel_lab.cli.capture.record import CaptureQuick, CaptureRecord
    from taccel_lab.cli.capture.rectify import CaptureRectify

    return {
        "check": CaptureCheckCommand,
        "guide": CaptureGuide,
        "devices": CaptureDevices,
        "record": CaptureRecord,
        "quick": CaptureQuick,
        "import": CaptureImport,
        "rectify": CaptureRectify,
    }
