# SPDX-License-Identifier: Apache-2.0
"""Designs in the task touch-insertion, and what the metrics read from its trials."""

from __future__ import annotations

from dataclasses import replace

import pytest

from taccel_lab.errors import InputError
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies.design_task import design_task
from taccel_lab.studies.evidence import Evidence
from taccel_lab.studies.metrics import METRICS
from taccel_lab.tasks.result import TaskResult, Trial, success_interval
from taccel_lab.tasks.run import run_task
from taccel_lab.tasks.touch_insertion import TouchInsertionParameters

CHANGES = {"thickness_mm": 2.5, "young_modulus_mpa": 0.3, "marker_pitch_mm": 4.0}


def test_a_design_gives_the_task_its_gels_and_markers() -> None:
    mini = sensor_family("gelsight_mini")
    task = design_task(mini.parameters(CHANGES))
    found = task.parameters
    assert isinstance(found, TouchInsertionParameters)
    assert found.gel.size_mm == pytest.approx((25.25, 20.75, 2.5))
    assert found.gel.young_modulus_pa == pytest.approx(3e5)
    assert found.markers.pitch_mm == (4.0, 1.9) and found.markers.columns == 5
    standard = design_task(mini.parameters()).parameters
    assert isinstance(standard, TouchInsertionParameters)
    assert found.policy == standard.policy and found.start == standard.start


def test_a_design_without_markers_is_refused() -> None:
    with pytest.raises(InputError, match="this design has none"):
        design_task(sensor_family("gelsight").parameters())


def test_softer_gels_push_less_hard() -> None:
    """The policy feels the rim by the same way of the markers."""
    forces = []
    for modulus in (0.1, 1.0):
        mini = sensor_family("gelsight_mini").parameters({**CHANGES, "young_modulus_mpa": modulus})
        task = design_task(mini)
        task = replace(task, parameters=task.parameters.replace(steps=14))
        (trial,) = run_task(task, [0], "cpu").trials
        forces.append(trial.figures["jam_force_n"])
    assert 0.1 < forces[0] < forces[1] / 3


def test_metrics_are_the_rate_and_its_interval() -> None:
    evidence = Evidence(sensor_family("gelsight_mini").parameters(), {})
    trials = [Trial(k, k < 12, "", 9, {}, {"jam_force_n": float(k)}) for k in range(16)]
    evidence.__dict__["insertion"] = TaskResult("touch-insertion", trials, 1.0, 16)
    names = ("insertion_success", "insertion_low", "insertion_high")
    rates = [METRICS[name].compute(evidence) for name in names]
    assert rates == pytest.approx([100 * rate for rate in success_interval(12, 16)])
    assert METRICS["insertion_force"].compute(evidence) == 7.5
