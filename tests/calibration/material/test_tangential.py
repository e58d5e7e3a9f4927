# SPDX-License-Identifier: Apache-2.0
"""Friction from shear and twist, simulated on a finer mesh and at other coefficients."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.ball_slide import simulate_ball_slide
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.press_plans import GelBench, simulate
from taccel_lab.calibration.material.tangential import fit_tangential
from taccel_lab.calibration.material.tangential_table import Motion, motion_plan
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from tests.calibration.material.made_up import COARSER, FAST, record

FRICTION, POISSON, MODULUS, DEPTH = 0.45, 0.47, 2.4e5, 0.6
STEPS = np.array([0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 1.9, 2.4]) * DEPTH


@pytest.fixture(autouse=True)
def small_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three coefficients and six steps instead of four and ten."""
    module = "taccel_lab.calibration.material.tangential_table"
    monkeypatch.setattr(f"{module}.NODES", 3)
    monkeypatch.setattr(f"{module}.STEPS", 6)


@pytest.fixture(scope="module")
def gel(mini: SensorProfile) -> Gel:
    return Gel.of_profile(mini, physics=COARSER).with_law(POISSON)


@pytest.fixture(scope="module")
def tool(gel: Gel) -> Tool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=4.0))


def moved(gel: Gel, tool: Tool, motion: Motion, scaled: np.ndarray) -> dict[str, np.ndarray]:
    """Forces of the true gel, at 1 MPa."""
    bench = GelBench(gel.with_physics(FAST), tool, DEPTH)
    return simulate(bench, motion_plan(bench, motion, scaled, FRICTION))


@pytest.fixture(scope="module")
def sheared(gel: Gel, tool: Tool, press_cache: Path) -> dict[str, np.ndarray]:
    """Shift [mm], tangential and normal force [N] of the true gel."""
    found = moved(gel, tool, "shear", STEPS)
    return {
        "shift_mm": STEPS * FRICTION,
        "tangential_n": found["tangential"] * MODULUS / 1e6,
        "normal_n": found["normal_n"] * MODULUS / 1e6,
    }


def shear_record(
    sheared: dict[str, np.ndarray], reach: float, noise: float, seed: int = 8
) -> ForceRecord:
    rng = np.random.default_rng(seed)
    shift = np.linspace(0, reach * sheared["shift_mm"][-1], 24)
    columns = {
        name: PchipInterpolator(sheared["shift_mm"], sheared[name])(shift)
        for name in ("tangential_n", "normal_n")
    }
    for name, values in columns.items():
        columns[name] = values + noise * values.max() * rng.standard_normal(24)
    return record("shear", depth_mm=np.full(24, DEPTH), shift_mm=shift, **columns)


def test_a_shear_tells_friction_and_stiffness(gel: Gel, tool: Tool, sheared: dict) -> None:
    hits, moduli = 0, []
    for seed in range(12):
        given = shear_record(sheared, 1.0, 0.01, seed)
        fit = fit_tangential(given, gel, tool)
        assert fit.friction_determined
        assert fit.friction == pytest.approx(FRICTION, rel=0.05)
        low, high = fit.friction_interval
        hits += low <= FRICTION <= high
        moduli.append(float(np.exp(fit.solution.value("ln_e"))))
    assert hits >= 10
    assert np.mean(moduli) == pytest.approx(MODULUS, rel=0.03)


def test_a_shear_that_sticks_gives_a_lower_bound(gel: Gel, tool: Tool, sheared: dict) -> None:
    given = shear_record(sheared, 0.08, 0.03)
    fit = fit_tangential(given, gel, tool)
    assert not fit.friction_determined
    assert [remark.code for remark in fit.remarks] == ["friction_undetermined"]


@pytest.mark.slow
def test_a_twist_tells_friction_with_the_modulus(gel: Gel, tool: Tool, press_cache: Path) -> None:
    scaled = np.degrees(STEPS[:-1] / tool.contact_radius_mm(DEPTH))
    found = moved(gel, tool, "twist", scaled)
    angle = np.linspace(0, scaled[-1] * FRICTION, 20)
    torque = PchipInterpolator(scaled * FRICTION, found["tangential"] * MODULUS / 1e6)(angle)
    given = record("twist", depth_mm=np.full(20, DEPTH), angle_deg=angle, torque_nmm=torque)
    fit = fit_tangential(given, gel, tool, young_pa=(MODULUS, 0.01))
    assert fit.friction == pytest.approx(FRICTION, rel=0.05)
    with pytest.raises(InputError, match="needs Young's modulus"):
        fit_tangential(given, gel, tool)


def test_a_sliding_ball_leans_on_the_gel(gel: Gel, tool: Tool, sheared: dict) -> None:
    ratio = float(sheared["tangential_n"][-1] / sheared["normal_n"][-1])
    assert ratio > 1.03 * FRICTION
    load = float(sheared["normal_n"][-1])
    slide = simulate_ball_slide(gel, tool, load, ratio, MODULUS)
    assert slide is not None
    assert slide.friction(ratio) == pytest.approx(FRICTION, rel=0.03)
    punch = gel.tool(ToolEntry(kind="cylinder", radius_mm=2.0))
    assert simulate_ball_slide(gel, punch, load, ratio, MODULUS) is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"depth_mm": np.linspace(0.1, 0.9, 24)}, "one held depth"),
        ({"shift_mm": np.zeros(24)}, "does not move"),
        ({"normal_n": np.full(24, -1.0)}, "must be positive"),
        ({"shift_mm": np.tile([0.0, 0.5, 0.0], 8)}, "before the motion turns back"),
    ],
)
def test_unfit_shears_are_refused(
    gel: Gel, tool: Tool, sheared: dict, change: dict, words: str
) -> None:
    bad = shear_record(sheared, 1.0, 0.0)
    bad.columns.update(change)
    with pytest.raises(InputError, match=words):
        fit_tangential(bad, gel, tool)
