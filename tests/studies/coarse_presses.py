# SPDX-License-Identifier: Apache-2.0
"""Standard presses on coarse meshes in few steps, and pads on which closed forms hold."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.mesh_options import OutlineMeshOptions, PressMeshOptions
from taccel_lab.sensors.families.gelsight import GelSightParameters
from taccel_lab.studies.presses.press_batch import PressJob, press_jobs, simulate
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.presses.standard import STANDARD_PRESSES, StandardPress

COARSE = PressMeshOptions(
    elements_per_radius=2.5,
    rings=6,
    layers=2,
    outline=OutlineMeshOptions(core=4, inner=2, outer=2, layers=2),
)
THICK = {
    "thickness_mm": 20.0, "length_x_mm": 60.0, "length_y_mm": 60.0, "crown_radius_mm": 0.0,
    "friction": 0.0,
}  # fmt: skip
"""Nearly a half-space for a contact of a millimetre."""


def coarse(press: str, /, **changes: Any) -> StandardPress:
    """A standard press on a mesh of some hundred nodes."""
    mesh = changes.pop("mesh", COARSE)
    physics = dataclasses.replace(PHYSICS[Accuracy.DEFAULT], mesh=mesh)
    return dataclasses.replace(STANDARD_PRESSES[press], physics=physics, **changes)


def jobs(press: StandardPress, **parameters: Any) -> list[PressJob]:
    """Simulations of a press on a GelSight."""
    return press_jobs(press, GelSightParameters(**parameters))


def pressed(press: StandardPress, **parameters: Any) -> PressRecord:
    """A GelSight pressed once, with the reference modulus."""
    record = simulate(jobs(press, **parameters))[0].record
    assert record.cause == ""
    return record


@functools.cache
def sphere_on_gelsight() -> PressRecord:
    """Three steps down on the default pad."""
    return pressed(coarse("sphere", steps=3))


def fake_record(**changes: Any) -> PressRecord:
    """The default press with arrays of one's own."""
    return dataclasses.replace(sphere_on_gelsight(), **changes)


def down_record(depth_mm: list[float], normal_n: list[float], **changes: Any) -> PressRecord:
    """A press straight down with these depths and forces."""
    count = len(depth_mm)
    real = sphere_on_gelsight()
    force = np.zeros((count, 3))
    force[:, 2] = normal_n
    return fake_record(
        depth_mm=np.array(depth_mm),
        force_n=force,
        **{
            "shear_mm": np.zeros(count),
            "twist_deg": np.zeros(count),
            "torque_nm": np.zeros(count),
            "bond_peak_pa": np.ones(count),
            "moved_m": np.repeat(real.moved_m[-1:], count, axis=0),
            **changes,
        },
    )
