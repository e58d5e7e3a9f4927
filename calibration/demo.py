# SPDX-License-Identifier: Apache-2.0
"""The main job end to end: real captures in, a designed and calibrated sensor out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture import (
    CaptureSet,
    ContactCircle,
    find_taxim_pack,
    load_captures,
)
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
from taccel_lab.calibration.color.fit import fit_color
from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.heldout import HeldoutSet
from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.contacts.result import DetectedContact
from taccel_lab.calibration.contacts.usable import usable_circles
from taccel_lab.calibration.simulate import PressSurfaces
from taccel_lab.calibration.surfaces import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.design import DesignResult, StageClock, design_sensor
from taccel_lab.sensors.registry import sensor_family

DEMO_SENSOR = "gelsight"
BATCH_PIXELS = 4096
"""Pixels of a step of the colour fit."""


@dataclass(frozen=True)
class DemoCalibration:
    """What the stages of the demo made."""

    captures: CaptureSet
    """The presses that were fitted."""
    design: DesignResult
    contacts: list[DetectedContact]
    circles: list[ContactCircle]
    surfaces: list[PressSurface]
    calibration: ColorCalibration
    profile: SensorProfile
    seconds: dict[str, float]
    """Time of each stage."""


def calibrate_demo(
    captures: Path | None, folder: Path, options: ColorFitOptions, progress: Progress = silent
) -> DemoCalibration:
    """Design the gel pad, find and simulate the presses, fit and score the colours.

    Args:
        captures: Capture folder of a gelsight; the GelSight presses of PyPI's taxim if None.
        folder: Gets the design in ``design`` and the calibrated sensor in ``profile``.
        options: Settings of the colour fit.
        progress: Told of the stages.

    Raises:
        InputError: Captures of another sensor, or that cannot be used.
        SimulationError: A press that did not converge.
    """
    seconds: dict[str, float] = {}
    clock = StageClock(seconds, progress)
    clock("loading the captures")
    presses = load_captures(captures or find_taxim_pack())
    split = presses.split(HOLDOUT_EVERY)
    training = presses.only(split.train)
    if presses.sensor != DEMO_SENSOR:
        raise InputError(
            f"{presses.source} was captured with sensor {presses.sensor!r}; the demo takes "
            f"captures of a {DEMO_SENSOR!r}"
        )
    clock("designing the gel pad")
    design = design_sensor(sensor_family(DEMO_SENSOR), None, folder / "design")
    base = on_grid(design.profile, presses.grid, presses.provenance)
    clock("finding the contact circles")
    usable = usable_circles(training, cache=False)
    training, circles = usable.captures, usable.circles
    clock("simulating the presses")
    # As calibrate color does: one law serves the others, the held-out presses too.
    make = PressSurfaces("simulated", base, cache=False, progress=progress)
    surfaces = make(training, circles)
    clock("fitting the colour model and scoring it")
    heldout = HeldoutSet.of(presses, split, make)
    found = fit_color(training, circles, surfaces, heldout, options=options, progress=progress)
    profile = found.apply_to(base)
    clock("exporting the profile")
    save_profile(profile, folder / "profile")
    clock(None)
    return DemoCalibration(
        training, design, usable.contacts, circles, surfaces, found, profile, seconds
    )
