# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate``: one command for each block, and all of them at once."""

from __future__ import annotations

from typing import Any


def calibrate_commands() -> dict[str, Any]:
    """The sub-commands by name; imported here so that help is fast."""
    from taccel_lab.cli.calibrate.all import CalibrateAll
    from taccel_lab.cli.calibrate.blocks import BLOCK_COMMANDS
    from taccel_lab.cli.calibrate.force import CalibrateForce
    from taccel_lab.cli.calibrate.refit import CalibrateRefit

    others = {"all": CalibrateAll, "force": CalibrateForce, "refit": CalibrateRefit}
    return dict(sorted({**others, **BLOCK_COMMANDS}.items()))
