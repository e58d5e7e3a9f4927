# SPDX-License-Identifier: Apache-2.0
"""A press has one force, whoever asks: ``press``, a study, a data set, a table of a material; alone
or beside others, in any order."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import GelBench
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.datasets.plan import DatasetPlan
from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.runner import make_dataset
from taccel_lab.datasets.spec import DatasetSpec
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import profile_parameters
from taccel_lab.studies.presses.press_batch import REFERENCE_PA, press_jobs, simulate
from taccel_lab.studies.presses.standard import StandardPress

CASES = [
    ({"thickness_mm": 10.0}, "sphere:1", 0.1, 0.0),
    ({"thickness_mm": 1.0}, "sphere:8", 0.2, 0.0),
    ({}, "sphere:4", 0.3, 1.0),
    ({}, "cylinder:2", 0.3, 0.0),
]
"""Pad, tool, depth [mm] and friction: contacts that are small and large beside the gel, one that
rubs, one with a rim."""


def pad(friction: float, **parameters: Any) -> SensorProfile:
    return catalogue_profile(
        "flat_pad", {"poisson_ratio": 0.46, "friction": friction, **parameters}
    )


def data_set(folder: Path, profile: SensorProfile, tool: str, **motion: Any) -> Dataset:
    """A data set of one touch at the middle of a pad."""
    save_profile(profile, folder / "pad")
    given = {
        "dataset": {"name": "one", "episodes": 1, "x_mm": [0, 0], "y_mm": [0, 0]},
        "sensors": [{"profile": "pad"}],
        "objects": [{"tool": tool, "yaw_deg": [0, 0]}],
        "motions": [motion],
        "output": {"channels": ["depth_mm"]},
    }  # fmt: skip
    plan = DatasetPlan(DatasetSpec.checked(given, "one.toml"), folder)
    assert make_dataset(plan, folder / "made", source="one", processes=0).complete
    return Dataset(folder / "made")


def study_n(profile: SensorProfile, tool: str, depth_mm: float, friction: float) -> float:
    steps = max(math.ceil(depth_mm / 0.2 - 1e-9), 1 + (friction > 0))
    press = StandardPress("one", (tool,), depth_mm=depth_mm, steps=steps)
    (simulated,) = simulate(press_jobs(press, profile_parameters(profile)))
    assert simulated.record.cause == ""
    scale = profile.material.young_modulus_pa / REFERENCE_PA
    return scale * float(simulated.record.force_n[-1, 2])


@pytest.mark.thorough
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[1]}, {case[2]} mm")
def test_a_press_has_one_force(
    case: tuple[dict[str, Any], str, float, float], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table has the press beside it that ``press`` has, and the same force; the others add what
    steps do under friction, and half of what a coarser mesh changes under rims."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    parameters, tool, depth_mm, friction = case
    profile = pad(friction, **parameters)
    known = tl.press(profile, tool, depth_mm=depth_mm, friction=friction)
    kind, radius = tool.split(":")
    gel = Gel.of_profile(profile)
    entry = ToolEntry.model_validate({"kind": kind, "radius_mm": float(radius)})
    table = GelBench(gel, gel.tool(entry), depth_mm, friction).pressed(gel)
    table_n = 1e-6 * profile.material.young_modulus_pa * float(table["force_n"][0])
    assert table_n == pytest.approx(known.force_n, rel=1e-3)
    assert float(table["error"][0]) == pytest.approx(known.force_error_n / known.force_n, rel=0.05)
    others = [study_n(profile, tool, depth_mm, friction)]
    touch = data_set(tmp_path, profile, tool, kind="press", depth_mm=[depth_mm] * 2)
    others.append(float(touch.steps["press_force_z_n"][-1]))
    assert others == pytest.approx([known.force_n] * 2, abs=known.force_error_n)


@pytest.mark.thorough
def test_the_force_of_a_touch_stays_where_it_slides_without_friction(tmp_path: Path) -> None:
    way = {"depth_mm": [0.3, 0.3], "shear_mm": [4.0, 4.0], "step_mm": 0.5}
    made = data_set(tmp_path, pad(0.0), "sphere:4", kind="slip", **way)
    force_n = made.steps["press_force_z_n"][made.steps["shear_x_mm"] ** 2 > 0]
    assert len(force_n) == 8
    np.testing.assert_allclose(force_n, force_n[0], rtol=0.015)


@pytest.mark.thorough
def test_a_press_does_not_depend_on_its_company() -> None:
    """Designs whose presses are 0.12 and 0.45 mm deep, in both orders and alone: the contact range
    follows each one's own depth."""
    press = StandardPress("one", ("sphere:3",), depth_fraction=0.15, steps=1)
    jobs = [
        press_jobs(press, profile_parameters(pad(0.0, thickness_mm=h)))[0] for h in (0.8, 3.0, 3.1)
    ]
    ranges = [job.setup.physics.dhat_m for job in jobs]
    assert ranges == pytest.approx([2.5e-6, 1e-5, 1e-5])
    assert jobs[0].batch_key != jobs[1].batch_key == jobs[2].batch_key
    alone = [simulate([job])[0].record.force_n[-1, 2] for job in jobs[1:]]
    for order in (jobs[1:], jobs[:0:-1]):
        together = {id(job): one.record for job, one in zip(order, simulate(order), strict=True)}
        for job, force_n in zip(jobs[1:], alone, strict=True):
            assert together[id(job)].force_n[-1, 2] == pytest.approx(force_n, rel=2e-4)
