# SPDX-License-Identifier: Apache-2.0
"""Puts the rooms that stand beside taccel_lab/ into the wheel, as parts of the package.

An editable installation gets none of them: it finds them through the links of the checkout, and a
copy would hide what is edited.
"""

from __future__ import annotations

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOMS = ("cad", "calibration", "sensors")


class WheelRooms(BuildHookInterface):
    """A build hook of hatchling."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if version != "editable":
            build_data["force_include"] |= {room: f"taccel_lab/{room}" for room in ROOMS}
