# SPDX-License-Identifier: Apache-2.0
"""Starter profiles: what was calibrated on one unit of a stock sensor, for all who have none yet.

``starters/NAME`` holds the calibrated blocks of a profile; the others are the catalogue's.
``starters/starters.toml`` says of each whose captures they rest on, under which licence, and how
well it scored. ``tools/starter_profiles.py`` makes them.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.files.documents import read_toml
from taccel_lab.profile import SensorProfile, load_profile

STARTERS = Path(__file__).parent / "starters"
ABOUT = STARTERS / "starters.toml"
NOT_YOUR_UNIT = "starter profile of another unit: calibrate yours"


def with_starter(design: SensorProfile) -> SensorProfile:
    """A design of the catalogue with the blocks of its starter, which its remarks name; the design
    itself where there is none."""
    name = design.sensor.name
    if not (STARTERS / name).is_dir():
        return design
    provenance = design.sensor.provenance.model_copy(
        update={"remarks": (NOT_YOUR_UNIT, read_toml(ABOUT)[name]["framing"])}
    )
    marked = design.with_block(design.sensor.replace(provenance=provenance))
    return load_profile(STARTERS / name, onto=marked)


def is_starter(profile: SensorProfile) -> bool:
    """Whether calibrated blocks of a profile are those of another unit."""
    return NOT_YOUR_UNIT in profile.sensor.provenance.remarks
