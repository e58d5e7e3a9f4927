# SPDX-License-Identifier: Apache-2.0
"""Likelihoods, their intervals, and the stiffness they give."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import t as student

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import ForceTable, TableError
from taccel_lab.calibration.material.gel import CurveTool, Gel, IndentationPoints
from taccel_lab.calibration.material.indentation import (
    USUAL_COUNT,
    USUAL_NOISE,
    IndentationFit,
    fit_indentation,
)
from taccel_lab.calibration.material.likelihood import CurveGroup, FittedParameter, Likelihood
from taccel_lab.calibration.material.stiffness import Stiffness, fit_stiffness
from taccel_lab.report.remark import Severity, Verdict, judge
from tests.calibration.material.made_up import layer_table, points

X = np.linspace(0.0, 1.0, 8)


def line(y: np.ndarray, weight: float = 1.0):
    columns = np.stack([X, np.ones_like(X)], axis=1)
    return lambda theta: ((columns @ theta - y) / weight, columns / weight)


def parameters(**changes: Any) -> list[FittedParameter]:
    return [
        FittedParameter("slope", 0.5, -50, 50, 1.0, **changes),
        FittedParameter("level", 0, -50, 50, 1.0),
    ]


def test_estimated_noise_gives_the_t_interval() -> None:
    rng = np.random.default_rng(4)
    y = 2 * X + 1 + 0.1 * rng.standard_normal(8)
    found = Likelihood(parameters(), [CurveGroup(8, False)], line(y)).solve()
    fit, covariance = np.polyfit(X, y, 1, cov=True)
    assert found.value("slope") == pytest.approx(fit[0], abs=1e-5)
    half = float(student.ppf(0.975, 6)) * np.sqrt(covariance[0, 0])
    low, high = found.profiles["slope"].interval
    assert (low, high) == pytest.approx((fit[0] - half, fit[0] + half), abs=2e-3 * half)
    assert found.sigma_of("slope") == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-4)
    expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert found.correlation[0, 1] == pytest.approx(expected, abs=1e-5)


def test_known_noise_gives_the_normal_interval_and_misfit_widens_it() -> None:
    rng = np.random.default_rng(5)
    noise = 0.1 * rng.standard_normal(8)
    y = 2 * X + 1 + noise
    found = Likelihood(parameters(), [CurveGroup(8, True)], line(y, 0.1)).solve(["slope"])
    assert not found.misfit and found.chi2_per_dof is not None and found.chi2_per_dof < 3
    sigma = 0.1 / np.sqrt(((X - X.mean()) ** 2).sum())
    low, high = found.profiles["slope"].interval
    assert high - low == pytest.approx(2 * 1.96 * sigma, rel=5e-3)
    too_sure = Likelihood(parameters(), [CurveGroup(8, True)], line(y, 0.01)).solve(["slope"])
    assert too_sure.misfit
    low_sure, high_sure = too_sure.profiles["slope"].interval
    assert high_sure - low_sure > 0.7 * (high - low)


def test_a_parameter_without_influence_is_open_on_both_sides() -> None:
    y = 2 * X + 1 + 0.05 * np.sin(40 * X)
    columns = np.stack([X, np.ones_like(X), np.zeros_like(X)], axis=1)
    named = [*parameters(), FittedParameter("idle", 0.2, 0.0, 1.0, 0.1)]
    found = Likelihood(
        named, [CurveGroup(8, False)], lambda theta: (columns @ theta - y, columns)
    ).solve(["idle"])
    profile = found.profiles["idle"]
    assert profile.open_low and profile.open_high
    assert profile.interval == (0.0, 1.0)


def test_a_prior_holds_what_data_leave_open() -> None:
    y = 2 * X + 1
    columns = np.stack([X, np.ones_like(X), np.ones_like(X)], axis=1)  # level twice
    named = [*parameters(), FittedParameter("twin", 0.3, -5, 5, 0.1, prior_sigma=0.1)]
    found = Likelihood(
        named, [CurveGroup(8, True)], lambda theta: ((columns @ theta - y) / 0.01, columns / 0.01)
    ).solve(["twin"])
    assert found.value("twin") == pytest.approx(0.3, abs=1e-3)
    assert found.sigma_of("twin") == pytest.approx(0.1, rel=1e-3)


def test_perfect_data_are_met_exactly() -> None:
    found = Likelihood(parameters(), [CurveGroup(8, False)], line(2 * X + 1)).solve()
    assert found.value("slope") == pytest.approx(2.0, abs=1e-6)
    low, high = found.profiles["slope"].interval
    assert low <= 2.0 + 1e-6 and high >= 2.0 - 1e-6 and high - low < 1e-4


def test_three_points_on_a_line_are_not_taken_for_exact() -> None:
    """A usual noise counts like as many readings; without it one degree of freedom says nothing."""
    y = np.array([0.0, 0.5, 1.0])
    x = np.array([0.0, 0.5, 1.0])
    columns = np.stack([x, np.ones(3)], axis=1)
    group = CurveGroup(3, False, usual=0.1, usual_count=1.0)
    found = Likelihood(parameters(), [group], lambda theta: (columns @ theta - y, columns)).solve()
    low, high = found.profiles["slope"].interval
    # Variance of (0 + 1 * 0.1^2) over 1 + 1 degrees of freedom, and the t of 2 of them.
    sigma = np.sqrt(0.01 / 2) / np.sqrt(0.5)
    assert high - low == pytest.approx(2 * student.ppf(0.975, 2) * sigma, rel=5e-3)
    assert found.noise == pytest.approx((np.sqrt(0.01 / 2),))


MODULUS_PA, POISSON = 2.4e5, 0.47
TOUCH_SIGMA_MM = 0.03
LARGEST_NOISE = 0.1
"""Beyond it a fit is no longer nearly linear."""
DRAWS = 300
ALLOWED = tuple(binom.interval(0.999, DRAWS, 0.95))
"""How many of the draws an interval of 95 % may hold the truth in."""


@pytest.fixture(scope="module")
def tool(gel: Gel) -> CurveTool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=7.5))


@pytest.fixture(scope="module")
def exact() -> ForceTable:
    """A table that is taken to have no error, so that noise alone makes the intervals."""
    table = layer_table("sphere", 7.5)
    return replace(table, error=TableError(0.0, np.zeros_like(table.error.mesh)))


def fitted(
    rng: np.random.Generator,
    tool: CurveTool,
    table: ForceTable,
    *,
    count: int,
    noise: float,
    stated: bool,
    scale: float = 1.0,
) -> tuple[IndentationFit, float]:
    """A fit without profiles to a drawn record, and how late its tool touched [mm].

    Args:
        count: Points of the record.
        noise: Standard deviation of a reading as a part of its force.
        stated: Whether the record states it.
        scale: Of the true forces over those of the table.
    """
    depth = np.linspace(0.3, 1.3, count)
    late_mm = float(rng.normal(0, TOUCH_SIGMA_MM))
    force = scale * table.force_n(depth - late_mm, MODULUS_PA, POISSON)
    read = force * (1 + noise * rng.normal(size=count))
    sigma = noise * force if stated else None
    fit = fit_indentation(
        [points(tool, depth, read, sigma)], [table], start_pa=1e5, poisson_ratio=POISSON,
        free_nu=False, touch_sigma_mm=TOUCH_SIGMA_MM, profiled=(),
    )  # fmt: skip
    assert not fit.solution.profiles
    return fit, late_mm


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("count", "stated"),
    [
        pytest.param(12, True, marks=pytest.mark.slow),
        pytest.param(4, True, marks=pytest.mark.slow),
        pytest.param(12, False, marks=pytest.mark.slow),
        (4, False),
    ],
)
def test_noise_alone(tool: CurveTool, exact: ForceTable, count: int, stated: bool) -> None:
    """Of a stated noise, and of one that a few points have to tell: usual, but for chance."""
    rng = np.random.default_rng(count)
    held = np.zeros(2, dtype=int)
    usual = USUAL_NOISE
    for _ in range(DRAWS):
        drawn = min(usual * np.sqrt(USUAL_COUNT / rng.chisquare(USUAL_COUNT)), LARGEST_NOISE)
        noise = usual if stated else drawn
        fit, late_mm = fitted(rng, tool, exact, count=count, noise=noise, stated=stated)
        low, high = fit.young_interval_pa
        held[0] += low <= MODULUS_PA <= high
        low, high = fit.touch_interval_mm(0)
        held[1] += low <= late_mm <= high
    # The touch point has a prior that is right: its interval holds it a little more often.
    assert ALLOWED[0] <= held[0] <= ALLOWED[1], held
    assert ALLOWED[0] <= held[1], held


@pytest.mark.thorough
def test_an_error_of_the_table_widens_the_interval(tool: CurveTool) -> None:
    """Of a table that is off by one factor, drawn from the error that it states."""
    table = layer_table("sphere", 7.5)
    table = replace(table, error=TableError(0.03, np.zeros_like(table.error.mesh)))
    rng = np.random.default_rng(7)
    held = 0
    for _ in range(DRAWS):
        scale = float(np.exp(0.03 * rng.normal()))
        fit, _ = fitted(rng, tool, table, count=12, noise=0.01, stated=True, scale=scale)
        low, high = fit.young_interval_pa
        held += low <= MODULUS_PA <= high
    assert ALLOWED[0] <= held <= ALLOWED[1]


@pytest.mark.parametrize("stated", [True, False])
def test_it_is_about_as_wide_as_the_profile(
    tool: CurveTool, exact: ForceTable, stated: bool
) -> None:
    """Of a fit that is nearly linear the likelihood falls as that of a normal, or t, does."""
    rng = np.random.default_rng(11)
    for count in (5, 12):
        bare, _ = fitted(rng, tool, exact, count=count, noise=0.01, stated=stated)
        likelihood = bare.likelihood
        whole = replace(bare, solution=likelihood.solve(("ln_e", "touch_0")))
        assert np.log(bare.young_interval_pa) == pytest.approx(
            np.log(whole.young_interval_pa), abs=0.1 * np.ptp(np.log(whole.young_interval_pa))
        )
        width = np.ptp(whole.touch_interval_mm(0))
        assert bare.touch_interval_mm(0) == pytest.approx(
            whole.touch_interval_mm(0), abs=0.1 * width
        )


MODULUS, HELD = 3e5, 0.46
FEW = np.array([0.4, 0.7, 1.0])
MANY = np.linspace(0.2, 1.2, 10)


@pytest.fixture(scope="module")
def ball(gel: Gel) -> CurveTool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=5.0))


@pytest.fixture(scope="module")
def table() -> ForceTable:
    return layer_table("sphere", 5.0)


def rubbed(table: ForceTable) -> ForceTable:
    """As if friction made presses stiffer, the deeper the more."""
    stiffer = 0.15 * table.depth_mm / table.depth_mm[-1]
    return replace(
        table, log_reduced=table.log_reduced + stiffer, error=TableError(0.0, np.zeros(1))
    )


def stiffness(
    given: IndentationPoints, tables: dict[float, ForceTable], free_nu: bool = True
) -> Stiffness:
    every = {mu: [table] for mu, table in tables.items()}
    return fit_stiffness([given], every, poisson_ratio=HELD, free_nu=free_nu, start_pa=4e5)


def inside(interval: tuple[float, float], value: float) -> bool:
    return interval[0] <= value <= interval[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depths", "zero_mm", "noise"),
    [(FEW, 0.05, 0.01), (MANY, 0.1, 0.01), (MANY, 0.0, 0.03)],
    ids=["few", "late zero", "noisy"],
)
def test_intervals_hold_what_the_points_do_not_tell(
    ball: CurveTool, table: ForceTable, depths: np.ndarray, zero_mm: float, noise: float
) -> None:
    """40 records of gels of any nu, fitted with 0.46 held where it is not told: the modulus, and
    the force of a press deeper than the record, and a held-back reading."""
    rng = np.random.default_rng(3)
    hits = np.zeros(3, dtype=int)
    records = 40
    deeper = 1.25
    for _ in range(records):
        nu = rng.uniform(0.42, 0.495)
        zero = zero_mm * rng.standard_normal()
        true = table.force_n(np.append(depths, deeper) - zero, MODULUS, nu)
        read = true * (1 + noise * rng.standard_normal(len(true)))
        found = stiffness(points(ball, depths, read[:-1]), {0.0: table})
        force = float(table.force_n(np.array([deeper]), MODULUS, nu)[0])
        hits[0] += inside(found.young.interval95, MODULUS)
        hits[1] += inside(found.force_interval_n(0, deeper), force)
        hits[2] += inside(found.force_interval_n(0, deeper, reading=True), float(read[-1]))
    # Of 40 that are in an interval of 95 % each, fewer than 34 would be 1 case in 300.
    assert (hits >= 34).all(), hits


@pytest.mark.thorough
def test_held_out_points_lie_in_their_intervals(ball: CurveTool, table: ForceTable) -> None:
    rng = np.random.default_rng(7)
    hits = []
    for _ in range(4):
        nu = rng.uniform(0.42, 0.495)
        force = table.force_n(MANY - 0.05 * rng.standard_normal(), MODULUS, nu)
        found = stiffness(
            points(ball, MANY, force * (1 + 0.02 * rng.normal(size=10))), {0.0: table}
        )
        assert len(found.held_out) == len(MANY)
        hits += [inside(item.interval_n, item.force_n) for item in found.held_out]
    assert sum(hits) >= 36  # of 40


@pytest.mark.thorough
def test_few_points_that_fit_are_not_called_good(ball: CurveTool, table: ForceTable) -> None:
    found = stiffness(points(ball, FEW, table.force_n(FEW, MODULUS, 0.48)), {0.0: table})
    assert np.abs(found.fit.relative_residuals(0)).max() < 0.01
    (said,) = [remark for remark in found.remarks if remark.code == "too_few"]
    assert said.severity is Severity.WARNING and "3 points and 2 fitted numbers" in said.message
    assert judge(found.remarks) is not Verdict.GOOD
    many = stiffness(points(ball, MANY, table.force_n(MANY, MODULUS, 0.48)), {0.0: table})
    assert "too_few" not in {remark.code for remark in many.remarks}


@pytest.mark.thorough
def test_points_choose_the_friction_that_explains_them(ball: CurveTool, table: ForceTable) -> None:
    tables = {0.0: table, 0.8: rubbed(table)}
    rng = np.random.default_rng(1)
    for mu, source in tables.items():
        force = source.force_n(MANY, MODULUS, HELD) * (1 + 0.005 * rng.standard_normal(10))
        found = stiffness(points(ball, MANY, force), tables, free_nu=False)
        assert found.friction == mu
        assert found.young.value == pytest.approx(MODULUS, rel=0.03)
        (said,) = [remark for remark in found.remarks if remark.code == "friction_assumed"]
        assert f"coefficient of {mu:g}" in said.message and said.severity is Severity.WARNING
    alone = stiffness(points(ball, MANY, force), {0.8: tables[0.8]}, free_nu=False)
    assert "friction_assumed" not in {remark.code for remark in alone.remarks}


def test_friction_that_points_do_not_tell_widens_intervals(
    ball: CurveTool, table: ForceTable
) -> None:
    force = table.force_n(FEW, MODULUS, HELD) * [1.01, 0.99, 1.005]
    given = points(ball, FEW, force)
    alone = stiffness(given, {0.0: table}, free_nu=False)
    both = stiffness(given, {0.0: table, 0.8: rubbed(table)}, free_nu=False)
    assert len(both.open_fits) == 2
    (low, high), (narrow_low, narrow_high) = both.young.interval95, alone.young.interval95
    assert low < 0.97 * narrow_low and high == pytest.approx(narrow_high, rel=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_a_force_at_a_recorded_depth_allows_for_the_zero(
    gel: Gel, ball: CurveTool, table: ForceTable, kind: Literal["sphere", "cylinder"]
) -> None:
    """First touch shifts what a record calls a depth, and not what a press calls one."""
    used = gel.tool(ToolEntry(kind=kind, radius_mm=5.0))
    force = table.force_n(MANY - 0.1, MODULUS, HELD)
    found = stiffness(points(used, MANY, force), {0.0: table}, free_nu=False)
    assert found.fit.touch_mm(0) == pytest.approx(0.1, abs=5e-3)
    recorded = found.force_interval_n(0, 0.8, reading=True)
    assert inside(recorded, float(table.force_n(np.array([0.7]), MODULUS, HELD)[0]))
    assert inside(
        found.force_interval_n(0, 0.8), float(table.force_n(np.array([0.8]), MODULUS, HELD)[0])
    )
    assert recorded[1] < found.force_interval_n(0, 0.8)[1]
