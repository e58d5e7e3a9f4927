# SPDX-License-Identifier: Apache-2.0
"""Likelihoods, their intervals, and the stiffness they give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom
from scipy.stats import t as student

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import ForceTable, TableError
from taccel_lab.calibration.material.indentation import (
    USUAL_COUNT,
    USUAL_NOISE,
    IndentationFit,
    fit_indentation,
    force_interval_n,
)
from taccel_lab.calibration.material.likelihood import (
    CurveGroup,
    FittedParameter,
    Likelihood,
    widened,
)
from taccel_lab.calibration.material.stiffness import Stiffness, fit_stiffness
from taccel_lab.report.remark import Severity, Verdict, judge
from tests.calibration.material.made_up import ball, gel, layer_table, points
from tests.support.variants import variants

X = np.linspace(0.0, 1.0, 8)
LINE = np.stack([X, np.ones_like(X)], axis=1)


def likelihood(
    y: np.ndarray,
    *more: FittedParameter,
    known: bool = False,
    weight: float = 1.0,
    design: np.ndarray = LINE,
    **usual: float,
) -> Likelihood:
    """Of slope and level, and ``more``, of points whose noise is ``weight`` where it is known."""
    named = [
        FittedParameter("slope", 0.5, -50, 50, 1.0),
        FittedParameter("level", 0, -50, 50, 1.0),
        *more,
    ]
    group = CurveGroup(len(y), known, **usual)  # type: ignore[arg-type]
    residuals: Callable = lambda p: ((design @ p - y) / weight, design / weight)  # noqa: E731
    return Likelihood(named, [group], residuals)


def test_estimated_noise_gives_the_t_interval() -> None:
    y = 2 * X + 1 + 0.1 * np.random.default_rng(4).standard_normal(8)
    found = likelihood(y).solve()
    fit, covariance = np.polyfit(X, y, 1, cov=True)
    sigma = np.sqrt(np.diag(covariance))
    assert found.value("slope") == pytest.approx(fit[0], abs=1e-5)
    half = float(student.ppf(0.975, 6)) * sigma[0]
    interval = (fit[0] - half, fit[0] + half)
    assert found.profiles["slope"].interval == pytest.approx(interval, abs=2e-3 * half)
    assert found.sigma_of("slope") == pytest.approx(sigma[0], rel=1e-4)
    expected = covariance[0, 1] / (sigma[0] * sigma[1])
    assert found.correlation[0, 1] == pytest.approx(expected, abs=1e-5)


def test_known_noise_gives_the_normal_interval_and_misfit_widens_it() -> None:
    y = 2 * X + 1 + 0.1 * np.random.default_rng(5).standard_normal(8)
    found, too_sure = (
        likelihood(y, known=True, weight=weight).solve(["slope"]) for weight in (0.1, 0.01)
    )
    assert not found.misfit and found.chi2_per_dof is not None and found.chi2_per_dof < 3
    assert too_sure.misfit
    width, sure = (np.ptp(each.profiles["slope"].interval) for each in (found, too_sure))
    sigma = 0.1 / np.sqrt(((X - X.mean()) ** 2).sum())
    assert width == pytest.approx(2 * 1.96 * sigma, rel=5e-3)
    assert sure > 0.7 * width


def test_a_parameter_without_influence_is_open_and_a_prior_holds_what_data_leave_open() -> None:
    y = 2 * X + 1 + 0.05 * np.sin(40 * X)
    idle = FittedParameter("idle", 0.2, 0.0, 1.0, 0.1)
    design = np.column_stack([LINE, np.zeros_like(X)])
    profile = likelihood(y, idle, design=design).solve(["idle"]).profiles["idle"]
    assert profile.open_low and profile.open_high and profile.interval == (0.0, 1.0)
    twin = FittedParameter("twin", 0.3, -5, 5, 0.1, prior_sigma=0.1)
    design = np.column_stack([LINE, np.ones_like(X)])  # level twice
    found = likelihood(2 * X + 1, twin, known=True, weight=0.01, design=design).solve(["twin"])
    assert found.value("twin") == pytest.approx(0.3, abs=1e-3)
    assert found.sigma_of("twin") == pytest.approx(0.1, rel=1e-3)


def test_perfect_data_are_met_exactly_and_three_points_on_a_line_are_not_taken_for_exact() -> None:
    found = likelihood(2 * X + 1).solve()
    assert found.value("slope") == pytest.approx(2.0, abs=1e-6)
    low, high = found.profiles["slope"].interval
    assert low - 1e-6 <= 2.0 <= high + 1e-6 and high - low < 1e-4
    # A usual noise counts like as many readings; without it one degree of freedom says nothing.
    x = np.array([0.0, 0.5, 1.0])
    design = np.stack([x, np.ones(3)], axis=1)
    found = likelihood(x, design=design, usual=0.1, usual_count=1.0).solve()
    # Variance of (0 + 1 * 0.1^2) over 1 + 1 degrees of freedom, and the t of 2 of them.
    width = 2 * student.ppf(0.975, 2) * np.sqrt(0.01 / 2) / np.sqrt(0.5)
    assert np.ptp(found.profiles["slope"].interval) == pytest.approx(width, rel=5e-3)
    assert found.noise == pytest.approx((np.sqrt(0.01 / 2),))


def test_a_further_error_widens_each_side_by_its_squares() -> None:
    assert widened((-1.0, 14.0), 2.0, 4.0) == pytest.approx((-3.0, 2.0 + np.hypot(12.0, 4.0)))
    assert widened((2.0, 2.0), 2.0, 4.0) == (-2.0, 6.0)


MODULUS_PA, POISSON = 2.4e5, 0.47
TOUCH_SIGMA_MM = 0.03
LARGEST_NOISE = 0.1
"""Beyond it a fit is no longer nearly linear."""
DRAWS = 300
LEAST, MOST = binom.interval(0.999, DRAWS, 0.95)
"""How many of the draws an interval of 95 % may hold the truth in."""


def table_of(error: float) -> ForceTable:
    """A table that one factor is off, by this error; without one noise alone makes intervals."""
    return replace(layer_table("sphere", 7.5), error=TableError(error, np.zeros(7)))


def inside(interval: tuple[float, float], value: float) -> bool:
    return interval[0] <= value <= interval[1]


def drawn(
    rng: np.random.Generator,
    table: ForceTable,
    count: int,
    noise: float,
    stated: bool,
    scale: float = 1.0,
) -> tuple[IndentationFit, float]:
    """A fit without profiles to a drawn record, and how late its tool touched [mm]."""
    depth = np.linspace(0.3, 1.3, count)
    late_mm = float(rng.normal(0, TOUCH_SIGMA_MM))
    force = scale * table.force_n(depth - late_mm, MODULUS_PA, POISSON)
    read = force * (1 + noise * rng.normal(size=count))
    given = points(ball(7.5), depth, read, noise * force if stated else None)
    fit = fit_indentation(
        [given], [table], start_pa=1e5, poisson_ratio=POISSON, free_nu=False,
        touch_sigma_mm=TOUCH_SIGMA_MM, profiled=(),
    )  # fmt: skip
    assert not fit.solution.profiles
    return fit, late_mm


@pytest.mark.thorough
@pytest.mark.parametrize(("count", "stated"), variants([(4, False)], [4, 12], [False, True]))
def test_noise_alone(count: int, stated: bool) -> None:
    """Of a stated noise, and of one that a few points have to tell: usual, but for chance."""
    rng, held = np.random.default_rng(count), np.zeros(2, dtype=int)
    for _ in range(DRAWS):
        noise = min(USUAL_NOISE * np.sqrt(USUAL_COUNT / rng.chisquare(USUAL_COUNT)), LARGEST_NOISE)
        noise = USUAL_NOISE if stated else noise
        fit, late_mm = drawn(rng, table_of(0.0), count, noise, stated)
        held[0] += inside(fit.young_interval_pa, MODULUS_PA)
        held[1] += inside(fit.touch_interval_mm(0), late_mm)
    # The touch point has a prior that is right: its interval holds it a little more often.
    assert LEAST <= held[0] <= MOST and LEAST <= held[1], held


@pytest.mark.thorough
def test_an_error_of_the_table_widens_the_interval() -> None:
    """Of a table that is off by one factor, drawn from the error that it states."""
    rng, held, table = np.random.default_rng(7), 0, table_of(0.03)
    for _ in range(DRAWS):
        scale = float(np.exp(0.03 * rng.normal()))
        fit, _ = drawn(rng, table, 12, 0.01, True, scale)
        held += inside(fit.young_interval_pa, MODULUS_PA)
    assert LEAST <= held <= MOST


def test_errors_of_the_table_are_held_by_their_size() -> None:
    """Of a modulus, and of a force, which the difference between the nodes is added to again."""

    def halves(interpolation: float, mesh: float) -> tuple[np.ndarray, np.ndarray]:
        table = replace(table_of(0.0), error=TableError(interpolation, np.full(7, mesh)))
        fit, _ = drawn(np.random.default_rng(11), table, 12, 0.01, True)
        force = np.log(force_interval_n(fit, 0, 0.9, recorded=False))
        return np.abs(np.log(fit.young_interval_pa) - fit.solution.value("ln_e")), np.ptp(force) / 2

    modulus, force = halves(0.0, 0.0)
    wide, same = halves(0.0, 0.1)
    np.testing.assert_allclose(np.sqrt(wide**2 - modulus**2), 0.196, rtol=1e-3)
    assert same == pytest.approx(force)
    assert np.sqrt(halves(0.05, 0.0)[1] ** 2 - force**2) == pytest.approx(0.098, rel=0.01)


@pytest.mark.parametrize("stated", [True, False])
def test_it_is_about_as_wide_as_the_profile(stated: bool) -> None:
    """Of a fit that is nearly linear the likelihood falls as that of a normal, or t, does."""
    rng = np.random.default_rng(11)
    for count in (5, 12):
        bare, _ = drawn(rng, table_of(0.0), count, 0.01, stated)
        whole = replace(bare, solution=bare.likelihood.solve(("ln_e", "touch_0")))
        for of in (lambda fit: np.log(fit.young_interval_pa), lambda fit: fit.touch_interval_mm(0)):
            assert of(bare) == pytest.approx(of(whole), abs=0.1 * np.ptp(of(whole)))


MODULUS, HELD = 3e5, 0.46
FEW = np.array([0.4, 0.7, 1.0])
MANY = np.linspace(0.2, 1.2, 10)


def true_n(depth: np.ndarray | float, nu: float = HELD) -> np.ndarray:
    return layer_table("sphere", 5.0).force_n(np.atleast_1d(depth), MODULUS, nu)


def rubbed() -> ForceTable:
    """As if friction made presses stiffer, the deeper the more."""
    table = layer_table("sphere", 5.0)
    stiffer = 0.15 * table.depth_mm / table.depth_mm[-1]
    error = TableError(0.0, np.zeros(1))
    return replace(table, log_reduced=table.log_reduced + stiffer, error=error)


def stiffness(
    depth: Any,
    force: np.ndarray | None = None,
    tables: dict[float, ForceTable] | None = None,
    free_nu: bool = True,
) -> Stiffness:
    """Of one press of a ball of 5 mm, or of points; ``tables`` by their friction."""
    given = points(ball(5.0), depth, force) if force is not None else depth
    every = {mu: [table] for mu, table in (tables or {0.0: layer_table("sphere", 5.0)}).items()}
    return fit_stiffness([given], every, poisson_ratio=HELD, free_nu=free_nu, start_pa=4e5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depths", "zero_mm", "noise"),
    [(FEW, 0.05, 0.01), (MANY, 0.1, 0.01), (MANY, 0.0, 0.03)],
    ids=["few", "late zero", "noisy"],
)
def test_intervals_hold_what_the_points_do_not_tell(
    depths: np.ndarray, zero_mm: float, noise: float
) -> None:
    """The modulus, the force of a deeper press and a reading of it, of gels of any nu."""
    rng, hits, deeper = np.random.default_rng(3), np.zeros(3, dtype=int), 1.25
    for _ in range(40):
        nu = rng.uniform(0.42, 0.495)
        true = true_n(np.append(depths, deeper) - zero_mm * rng.standard_normal(), nu)
        *read, last = true * (1 + noise * rng.standard_normal(len(true)))
        found = stiffness(depths, np.array(read))
        hits += [
            inside(found.young.interval95, MODULUS),
            inside(found.force_interval_n(0, deeper), float(true_n(deeper, nu)[0])),
            inside(found.force_interval_n(0, deeper, reading=True), float(last)),
        ]
    # Of 40 that are in an interval of 95 % each, fewer than 34 would be 1 case in 300.
    assert (hits >= 34).all(), hits


@pytest.mark.thorough
def test_held_out_points_lie_in_their_intervals() -> None:
    rng, hits = np.random.default_rng(7), []
    for _ in range(4):
        nu = rng.uniform(0.42, 0.495)
        force = true_n(MANY - 0.05 * rng.standard_normal(), nu)
        found = stiffness(MANY, force * (1 + 0.02 * rng.normal(size=10)))
        hits += [inside(item.interval_n, item.force_n) for item in found.held_out]
    assert len(hits) == 40 and sum(hits) >= 36


@pytest.mark.thorough
def test_few_points_that_fit_are_not_called_good() -> None:
    few, many = (stiffness(depth, true_n(depth, 0.48)) for depth in (FEW, MANY))
    assert np.abs(few.fit.relative_residuals(0)).max() < 0.01
    (said,) = [remark for remark in few.remarks if remark.code == "too_few"]
    assert said.severity is Severity.WARNING and "3 points and 2 fitted numbers" in said.message
    assert judge(few.remarks) is not Verdict.GOOD
    assert "too_few" not in {remark.code for remark in many.remarks}


@pytest.mark.thorough
def test_points_choose_the_friction_that_explains_them() -> None:
    tables, rng = {0.0: layer_table("sphere", 5.0), 0.8: rubbed()}, np.random.default_rng(1)
    for mu, source in tables.items():
        force = source.force_n(MANY, MODULUS, HELD) * (1 + 0.005 * rng.standard_normal(10))
        found = stiffness(MANY, force, tables, free_nu=False)
        assert found.friction == mu
        assert found.young.value == pytest.approx(MODULUS, rel=0.03)
        (said,) = [remark for remark in found.remarks if remark.code == "friction_assumed"]
        assert f"coefficient of {mu:g}" in said.message and said.severity is Severity.WARNING
    alone = stiffness(MANY, force, {0.8: tables[0.8]}, free_nu=False)
    assert "friction_assumed" not in {remark.code for remark in alone.remarks}


def test_friction_that_points_do_not_tell_widens_intervals() -> None:
    force, plain = true_n(FEW) * [1.01, 0.99, 1.005], layer_table("sphere", 5.0)
    alone = stiffness(FEW, force, free_nu=False)
    both = stiffness(FEW, force, {0.0: plain, 0.8: rubbed()}, free_nu=False)
    assert len(both.open_fits) == 2
    (low, high), (narrow_low, narrow_high) = both.young.interval95, alone.young.interval95
    assert low < 0.97 * narrow_low and high == pytest.approx(narrow_high, rel=0.02)
    # What is stated beside the interval is one standard deviation.
    assert both.young.sigma == pytest.approx(
        both.young.value * np.log(high / low) / 2 / 1.96, rel=1e-4
    )


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_a_force_at_a_recorded_depth_allows_for_the_zero(kind) -> None:
    """First touch shifts what a record calls a depth, and not what a press calls one."""
    tool = gel().tool(ToolEntry(kind=kind, radius_mm=5.0))
    found = stiffness(points(tool, MANY, true_n(MANY - 0.1)), free_nu=False)
    assert found.fit.touch_mm(0) == pytest.approx(0.1, abs=5e-3)
    recorded, press = (found.force_interval_n(0, 0.8, reading=each) for each in (True, False))
    assert inside(recorded, float(true_n(0.7)[0]))
    assert inside(press, float(true_n(0.8)[0]))
    assert recorded[1] < press[1]
