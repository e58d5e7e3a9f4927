# SPDX-License-Identifier: Apache-2.0
"""What an export says of itself: what it carries, what it had to leave out, how far it is off."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeVar

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile

T = TypeVar("T")

MAKERS = {
    "background": "taccel-lab calibrate background or calibrate color",
    "color": "taccel-lab calibrate color",
    "normals": "taccel-lab calibrate normals",
    "force": "taccel-lab calibrate force",
    "markers": "taccel-lab calibrate markers",
    "optics": "taccel-lab calibrate camera, or a design of the catalogue",
    "depth_response": "taccel-lab calibrate depth",
    "perturbation": "captures of several days or units",
    "lights": "a design of the catalogue (taccel-lab design)",
    "housing": "a design of the catalogue (taccel-lab design)",
}
"""What makes each optional block that an exporter may ask for."""


@dataclass
class ExportRecord:
    """The contents of ``export.json`` besides the list of files."""

    carries: dict[str, str] = field(default_factory=dict)
    """Block of the profile: what of it is in the files."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Block or quantity: why it is not."""
    approximations: dict[str, float] = field(default_factory=dict)
    """Measured errors of what the format can only approximate, and the figures to judge them by;
    units in the names."""
    notes: list[str] = field(default_factory=list)
    """Conventions that a user of the files has to know."""

    def leave_out_missing(self, profile: SensorProfile, *keys: str) -> None:
        """Note the optional blocks that the format could carry but the profile lacks."""
        for key in keys:
            if getattr(profile, key) is None:
                self.left_out[key] = f"the profile has no {key} block; made by {MAKERS[key]}"

    def no_place_for(self, profile: SensorProfile, *keys: str) -> None:
        """Note the blocks that the profile has and the format cannot hold."""
        for key in keys:
            if getattr(profile, key) is not None:
                self.left_out[key] = "the format has no place for it"

    def dots_stand_still(self, profile: SensorProfile) -> None:
        """Notes for formats that paint on one background image that the gel's dots stand still:
        they are part of it."""
        if profile.markers is not None and profile.background_rgb is not None:
            self.left_out["markers"] = (
                "the format has no place for their motion: dots are in the background, where they "
                "stand still while the gel moves; SignalTactile.from_profile moves them"
            )


def required(profile: SensorProfile, key: str, wanted_for: str, value: T | None) -> T:
    """``value`` of the block ``key``; an InputError that says what makes it when it is None."""
    if value is None:
        present = ", ".join(profile.blocks())
        raise InputError(
            f"{wanted_for} needs the block {key}, which the profile of {profile.sensor.name!r} "
            f"lacks (it has {present}); it is made by {MAKERS[key]}"
        )
    return value
