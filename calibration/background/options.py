# SPDX-License-Identifier: Apache-2.0
"""Options of a calibration of the background."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class BackgroundOptions:
    """Units to compare besides the frames of the folder."""

    units: tuple[SensorProfile, ...] = ()
    """Profiles of several units of one design, the one at hand among them where it is known."""
