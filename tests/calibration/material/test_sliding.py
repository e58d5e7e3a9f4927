# SPDX-License-Identifier: Apache-2.0
"""Friction from slide records of a spring-loaded slider with known coefficient."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.ball_slide import simulate_ball_slide, slide_plan
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.press_plans import GelBench, simulate
from taccel_lab.calibration.material.robust_statistics import combined
from taccel_lab.calibration.material.sliding import SlideFit, fit_slide
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from tests.calibration.material.made_up import COARSER, FAST, record


def slide(
    mu: float = 0.8,
    noise: float = 0.0,
    *,
    stiffness: float = 4.0,
    offset: float = 0.0,
    back: bool = True,
    slips: float = 0.0,
    load: float = 3.0,
    seed: int = 0,
    sign: int = 1,
) -> ForceRecord:
    """A slider on a spring; after each slip the spring keeps ``1 - slips`` of its force."""
    rng = np.random.default_rng(seed)
    shift = np.linspace(0, 4, 160)
    if back:
        shift = np.concatenate([shift, shift[::-1]])
    normal = load + 0.1 * np.sin(3 * shift)
    force, anchor = np.zeros(len(shift)), 0.0
    for i, (s, n) in enumerate(zip(shift, normal, strict=True)):
        force[i] = stiffness * (s - anchor)
        if abs(force[i]) > mu * n:
            anchor = s - np.sign(force[i]) * (1 - slips) * mu * n / stiffness
            force[i] = stiffness * (s - anchor)
    return record(
        "slide",
        shift_mm=shift,
        normal_n=normal + noise * rng.standard_normal(len(shift)),
        tangential_n=sign * force + offset + noise * rng.standard_normal(len(shift)),
    )


def codes(fit: SlideFit) -> set[str]:
    return {remark.code for remark in fit.remarks}


@pytest.mark.parametrize("sign", [1, -1])
def test_perfect_slides_give_friction_and_offset_exactly(sign: int) -> None:
    """Whatever the sign of the tangential force."""
    fit = fit_slide(slide(0.8, offset=0.15, sign=sign))
    assert fit.friction.value == pytest.approx(0.8, abs=1e-9)
    assert fit.offset_n == pytest.approx(0.15, abs=1e-9)
    assert not fit.remarks


def test_the_truth_lies_in_the_interval() -> None:
    hits, values = 0, []
    for seed in range(100):
        fit = fit_slide(slide(0.8, 0.08, offset=0.1, seed=seed))
        low, high = fit.friction.interval95
        hits += low <= 0.8 <= high
        values.append(fit.friction.value)
    assert hits >= 90
    assert np.abs(np.array(values) / 0.8 - 1).max() < 0.05


def test_outliers_do_not_bend_it() -> None:
    clean = slide(0.6, 0.02)
    clean.columns["tangential_n"][50:320:30] += 5.0
    assert fit_slide(clean).friction.value == pytest.approx(0.6, rel=0.02)


def test_a_tool_that_never_slides_gives_a_lower_bound() -> None:
    fit = fit_slide(slide(0.8, 0.01, stiffness=0.4, back=False))
    assert not fit.slid and codes(fit) == {"never_slid"}
    assert 0.4 < fit.friction.value < 0.6


def test_one_direction_is_enough() -> None:
    assert fit_slide(slide(0.8, 0.02, back=False)).friction.value == pytest.approx(0.8, rel=0.02)


def test_a_tool_that_sticks_and_slips_gives_the_mean() -> None:
    fit = fit_slide(slide(0.8, 0.01, slips=0.3))
    assert fit.friction.value == pytest.approx(0.68, rel=0.05)


def test_records_that_scatter_widen_the_error() -> None:
    fits = [
        fit_slide(slide(mu, 0.01, load=load)) for mu, load in ((0.9, 1.0), (0.72, 2.0), (0.6, 4.0))
    ]
    estimate = combined([fit.friction for fit in fits])
    assert estimate.value == pytest.approx(0.74, abs=0.03)
    assert estimate.sigma > 0.05


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"normal_n": lambda v: np.where(np.arange(len(v)) == 5, 0.0, v)}, "lifted"),
        ({"shift_mm": np.zeros_like}, "does not change"),
        ({"tangential_n": lambda v: 100 * v}, "not swapped"),
        ({"tangential_n": lambda v: 1e-3 * v}, "not swapped"),
        ({"shift_mm": lambda v: np.random.default_rng(0).random(len(v))}, "no stroke"),
    ],
)
def test_unfit_slides_are_refused(change, words: str) -> None:
    bad = slide(0.8)
    for name, spoil in change.items():
        bad.columns[name] = spoil(bad.columns[name])
    with pytest.raises(InputError, match=words):
        fit_slide(bad)


@pytest.mark.slow
def test_a_sliding_ball_leans_on_the_gel(mini: SensorProfile, press_cache: Path) -> None:
    """Friction is found in the forces of a slide on a finer mesh."""
    gel = Gel.of_profile(mini, physics=COARSER).with_law(0.47)
    tool = gel.tool(ToolEntry(kind="sphere", radius_mm=4.0))
    bench = GelBench(gel.with_physics(FAST), tool, 0.6)
    way = 0.6 * np.array([0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 1.9, 2.4])
    found = simulate(bench, slide_plan(bench, way, 0.45))
    ratio = float(found["tangential_n"][-1] / found["normal_n"][-1])
    assert ratio > 1.03 * 0.45
    load = 0.24 * float(found["normal_n"][-1])
    slid = simulate_ball_slide(gel, tool, load, ratio, 2.4e5)
    assert slid is not None
    assert slid.friction(ratio) == pytest.approx(0.45, rel=0.03)


def test_a_flat_punch_does_not_lean(mini: SensorProfile) -> None:
    gel = Gel.of_profile(mini, physics=COARSER).with_law(0.47)
    punch = gel.tool(ToolEntry(kind="cylinder", radius_mm=2.0))
    assert simulate_ball_slide(gel, punch, 1.0, 0.5, 2.4e5) is None
