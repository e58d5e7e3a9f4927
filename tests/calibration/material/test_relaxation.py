# SPDX-License-Identifier: Apache-2.0
"""Damping from ramps and holds of made-up solids: Kelvin and Voigt's, and Zener's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.damping_gain import damped_forces, damping_gain
from taccel_lab.calibration.material.force_table import ForceTable, TableError, force_table
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.material.relaxation import DampingFit, fit_damping
from taccel_lab.errors import InputError
from tests.calibration.material.made_up import COARSE, FAST, record

TIME = np.arange(0, 3, 0.02)
DEPTH = np.minimum(2 * TIME, 1.0)
RATE = np.where(TIME < 0.5, 2.0, 0.0)
TOOL = Tool("sphere", 4.0, (0.0, 0.0), "sphere:4")
MODULUS = 2e5


def hertz() -> ForceTable:
    """A half-space: ln(F / d^1.5) is a constant."""
    depths = np.log(np.linspace(0.1, 1.2, 5))
    level = np.full((1, 1, 5), np.log(4 / 3 / (1 - 0.25) * 2.0 * 1e-6))
    table = ResponseTable(Axis(0.0, 0.0), Axis(0.5, 0.5), depths, level)
    return ForceTable(1.5, table, TableError(0.0, np.zeros(5)))


def fit(force: np.ndarray, depth: np.ndarray = DEPTH) -> DampingFit:
    return fit_damping(ramp(force, depth), TOOL, hertz())


def ramp(force: np.ndarray, depth: np.ndarray = DEPTH) -> ForceRecord:
    return record("relaxation", time_s=TIME, depth_mm=depth, force_n=force)


def elastic(depth: np.ndarray = DEPTH) -> np.ndarray:
    return hertz().force_n(depth, MODULUS, 0.5)


def viscous(depth: np.ndarray = DEPTH, rate: np.ndarray = RATE) -> np.ndarray:
    """d(force)/dt of the elastic force."""
    return np.where(depth > 0, 1.5 * elastic(depth) / np.maximum(depth, 1e-9), 0.0) * rate


def noise(seed: int) -> np.ndarray:
    return 0.004 * elastic().max() * np.random.default_rng(seed).standard_normal(len(TIME))


def test_the_damping_time_of_a_kelvin_voigt_solid() -> None:
    hits = 0
    for seed in range(40):
        found = fit(elastic() + 0.08 * viscous() + noise(seed))
        assert found.relaxation is None and found.damping_time_s is not None
        assert found.damping_time_s.value == pytest.approx(0.08, rel=0.1)
        assert found.young_modulus_pa == pytest.approx(MODULUS, rel=0.01)
        low, high = found.damping_time_s.interval95
        hits += low <= 0.08 <= high
    assert hits >= 34  # the speed is smoothed over the ramp's corner, which costs a little


def test_smooth_motion_gives_it_exactly() -> None:
    depth = 0.5 * (1 - np.cos(2 * np.pi * TIME / 3))
    rate = np.pi / 3 * np.sin(2 * np.pi * TIME / 3)
    found = fit(elastic(depth) + 0.08 * viscous(depth, rate), depth)
    assert found.damping_time_s is not None
    assert found.damping_time_s.value == pytest.approx(0.08, rel=2e-3)
    assert found.young_modulus_pa == pytest.approx(MODULUS, rel=1e-3)


def test_an_elastic_gel_has_none_to_tell() -> None:
    found = fit(elastic() + noise(3))
    assert found.damping_time_s is None
    assert [remark.code for remark in found.remarks] == ["damping_undetermined"]


def test_a_gel_that_relaxes_is_reported_and_not_fitted() -> None:
    fading = np.where(TIME < 0.5, 1.0, np.exp(-(TIME - 0.5) / 0.6))
    found = fit(elastic() * (1 + 0.3 * fading) + noise(1))
    assert found.damping_time_s is None
    assert found.relaxation is not None
    assert found.relaxation.time_s == pytest.approx(0.6, rel=0.1)
    assert found.relaxation.part == pytest.approx(0.3 / 1.3, rel=0.1)
    assert [remark.code for remark in found.remarks] == ["relaxes"]
    assert found.young_modulus_pa < 1.12 * MODULUS


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"depth_mm": -DEPTH}, "never rises"),
        ({"force_n": -elastic()}, "does not grow"),
    ],
)
def test_unfit_records_are_refused(changes: dict, words: str) -> None:
    bad = ramp(elastic())
    bad.columns.update(changes)
    with pytest.raises(InputError, match=words):
        fit_damping(bad, TOOL, hertz())


@pytest.mark.slow
def test_the_solver_damps_as_the_fit_assumes(gel: Gel, press_cache: Path) -> None:
    """A dynamic press, faster and more damped than the one that gives the gain, is met by it."""
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=5.0))
    gel = gel.with_law(0.45).with_physics(COARSE)
    shallow = damping_gain(gel.with_physics(FAST), tool, 0.2)
    assert shallow[0] + 0.1 * shallow[1] == pytest.approx(1.0, abs=0.15)
    gain = damping_gain(gel, tool, 0.8)
    assert 0.55 < gain[0] + 0.8 * gain[1] < 0.8
    table = force_table(gel, tool, (0.1, 0.8), free_nu=False)
    force = damped_forces(gel, tool, 0.8, 0.06) * MODULUS / 1e6
    time = 0.01 * np.arange(1, 31)
    given = record("relaxation", 5.0, time_s=time, depth_mm=0.8 * time / 0.3, force_n=force)
    found = fit_damping(given, tool, table, gain)
    assert found.damping_time_s is not None
    assert found.damping_time_s.value == pytest.approx(0.06, rel=0.1)
    # A ramp without a hold hardly tells stiff from viscous.
    assert found.young_modulus_pa == pytest.approx(MODULUS, rel=0.05)
