# SPDX-License-Identifier: Apache-2.0
"""Moduli from force against depth, and the points that are taken of a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.capture.schema import RecordEntry, ToolEntry
from taccel_lab.calibration.material.force_table import (
    ForceTable,
    GelBench,
    TableError,
    force_table,
)
from taccel_lab.calibration.material.gel import CurveTool, Gel, IndentationPoints, points_of_record
from taccel_lab.calibration.material.indentation import IndentationFit, fit_indentation
from taccel_lab.calibration.material.remarks import require_plausible
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.with_error import NORMAL_95
from tests.calibration.material.made_up import (
    COARSE,
    COARSER,
    DEFAULT,
    FAST,
    ball,
    gel,
    layer_table,
    points,
)

DEPTH = np.linspace(0.15, 1.4, 12)
MODULUS, POISSON = 2.4e5, 0.47
KNOWN = {"poisson_ratio": POISSON, "free_nu": False}


def true_n(depth: np.ndarray = DEPTH, radius_mm: float = 7.5) -> np.ndarray:
    return layer_table("sphere", radius_mm).force_n(depth, MODULUS, POISSON)


def fits(
    sets: Sequence[IndentationPoints], tables: Sequence[ForceTable], **more: Any
) -> IndentationFit:
    """From a start beside the truth."""
    settings: dict[str, Any] = {"start_pa": 4e5, "poisson_ratio": 0.45}
    return fit_indentation(sets, tables, **settings | more)


def fitted(
    force: np.ndarray,
    sigma: np.ndarray | None = None,
    zero: Estimate | None = None,
    depth: np.ndarray = DEPTH,
    **more: Any,
) -> IndentationFit:
    """Of one press of a ball of 7.5 mm on a layer."""
    item = replace(points(ball(7.5), depth, force, sigma), zero=zero)
    return fits([item], [layer_table("sphere", 7.5)], **more)


def pressed_n(
    gel: Gel, tool: CurveTool, depths_mm: np.ndarray, nu: float, physics: PressPhysics
) -> np.ndarray:
    """Forces [N] of presses of 1 MPa to each depth."""
    own = replace(gel.with_law(nu), physics=physics)
    benches = [GelBench(own, tool, depth) for depth in depths_mm.tolist()]
    return np.array([bench.pressed(own)["force_n"][0] for bench in benches])


def test_an_uncertain_zero_of_the_load_cell_widens_the_interval() -> None:
    truth = true_n()
    left = 0.04 * truth.max()
    trusted, known, exact = (
        fitted(
            truth + left, 0.005 * truth + 1e-3, zero, touch_sigma_mm=0.0, profiled=("ln_e",),
            **KNOWN,
        )
        for zero in (None, Estimate(1.0, left, "N"), Estimate(1.0, 1e-6, "N"))
    )  # fmt: skip
    assert "zero_0" not in trusted.solution.names
    assert known.solution.value("zero_0") == pytest.approx(left, rel=0.1)
    assert known.young_modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert abs(trusted.young_modulus_pa / MODULUS - 1) > 0.03
    assert exact.young_modulus_pa == pytest.approx(trusted.young_modulus_pa, rel=1e-3)
    assert known.solution.sigma_of("ln_e") > 0


@pytest.mark.slow
@pytest.mark.usefixtures("press_cache")
def test_presses_of_mooney_and_rivlin_lie_on_their_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a ratio that is held: five presses at each of two depths, against one elsewhere."""
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 2)
    mini = catalogue_profile("gelsight_mini")
    gel = Gel.of_profile(mini, "mooney_rivlin", physics=COARSER).with_law(POISSON, 0.7)
    table = force_table(gel, ball(7.5), (0.1, 0.3))
    assert table.press_count == 5 * 2
    assert table.error.interpolation < 2e-3
    assert table.nu_range[0] > 0.7 / 2.4  # softer volumes do not go with this ratio
    force = pressed_n(gel, ball(7.5), table.depth_mm[1:], 0.485, COARSER)
    np.testing.assert_allclose(table.force_n(table.depth_mm[1:], 1e6, 0.485), force, rtol=3e-3)


@pytest.mark.parametrize(
    ("kind", "exponent", "friction"), [("sphere", 1.5, 0), ("sphere", 1.5, 0.3), ("cylinder", 1, 0)]
)
def test_four_presses_and_one_between_make_a_row_of_a_table(
    monkeypatch: pytest.MonkeyPatch, kind, exponent: float, friction: float
) -> None:
    def made_up(bench: GelBench, gel: Gel) -> dict[str, np.ndarray]:
        depth, s = np.array([bench.depth_mm]), np.sqrt(1 - 2 * gel.material.poisson_ratio)
        force = 1e6 * depth**exponent * np.exp(1.3 - 2 * s + 0.7 * s**3 * depth)
        return {"force_n": force, "error": np.array([0.01]), "seconds": np.array(0.5)}

    monkeypatch.setattr(GelBench, "pressed", made_up)
    tool = gel().tool(ToolEntry(kind=kind, radius_mm=2.0))
    table = force_table(gel(), tool, (0.2, 1.0), friction=friction)
    depth = table.depth_mm
    assert (table.press_count, table.seconds) == (5 * len(depth), 2.5 * len(depth))
    assert table.error.interpolation < 1e-9
    assert table.error.mesh == pytest.approx(0.01 / NORMAL_95)
    for nu in (0.31, 0.45, 0.498):
        s = np.sqrt(1 - 2 * nu)
        value, _, by_nu = table.log_force(depth, nu)
        expected = exponent * np.log(depth) + 1.3 - 2 * s + 0.7 * s**3 * depth
        np.testing.assert_allclose(value, expected, atol=1e-9)
        np.testing.assert_allclose(by_nu, (2 - 2.1 * s**2 * depth) / s, rtol=1e-8)
        between, by_depth, _ = table.log_force(depth[1:-1] + 0.01, nu)
        ahead = table.log_force(depth[1:-1] + 0.01 + 1e-6, nu)[0]
        np.testing.assert_allclose((ahead - between) / 1e-6, by_depth, rtol=1e-4)
    np.testing.assert_allclose(table.force_n(np.array([-1.0, 0.0]), 1e5, 0.47), 0.0)


def test_perfect_data_come_back_exactly_and_a_late_zero_is_found() -> None:
    fit = fitted(true_n())
    assert fit.young_modulus_pa == pytest.approx(MODULUS, rel=1e-4)
    assert fit.poisson_ratio == pytest.approx(POISSON, abs=1e-4)
    assert fit.touch_mm(0) == pytest.approx(0.0, abs=1e-4)
    # A trusted touch is not fitted.
    fit = fitted(true_n(), touch_sigma_mm=0.0, **KNOWN)
    assert fit.touch_mm(0) == 0.0 and fit.touch_interval_mm(0) == (0.0, 0.0)
    assert np.abs(fit.relative_residuals(0)).max() < 1e-6
    # But for what 0.15 mm are unlikely: 0.75 of a standard deviation of the zero, against points
    # that usually scatter.
    fit = fitted(true_n(DEPTH + 0.15))
    assert fit.touch_mm(0) == pytest.approx(-0.15, abs=3e-3)
    assert fit.young_modulus_pa == pytest.approx(MODULUS, rel=5e-3)
    low, high = fit.touch_interval_mm(0)
    assert low < -0.15 < high < low + 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("press_cache")
def test_the_modulus_of_a_finer_simulation_within_its_interval(monkeypatch) -> None:
    """100 records with 1 % noise and touch points that are off by 0.02 mm."""
    monkeypatch.setattr("taccel_lab.calibration.material.force_table.DEPTHS", 4)
    table = force_table(replace(gel(), physics=COARSE), ball(7.5), (0.2, 1.2))
    rng = np.random.default_rng(11)
    depths = np.array([0.2, 0.45, 0.7, 0.95, 1.2])
    truth = pressed_n(gel(), ball(7.5), depths, POISSON, FAST) * MODULUS / 1e6
    hits, errors = 0, []
    for _ in range(100):
        touch = 0.02 * rng.standard_normal()
        force = truth * (1 + 0.01 * rng.standard_normal(len(depths)))
        given = [points(ball(7.5), depths + touch, force)]
        fit = fits(given, [table], touch_sigma_mm=0.02, **KNOWN)
        low, high = fit.young_interval_pa
        hits += low <= MODULUS <= high
        errors.append(fit.young_modulus_pa / MODULUS - 1)
    assert hits >= 90  # a 95 % interval misses more than 10 of 100 in 1 of 100 such tests
    assert abs(np.mean(errors)) < 0.02
    assert np.percentile(np.abs(errors), 95) < 0.04


def test_errors_of_two_tables_that_differ_widen_poisson_ratio() -> None:
    """Forces of one of two balls are 2 % off, which no residual shows."""
    error = TableError(0.0, np.full(7, 0.02))
    rough = [replace(layer_table("sphere", radius), error=error) for radius in (2.0, 15.0)]
    exact = [points(ball(radius), DEPTH, true_n(DEPTH, radius)) for radius in (2.0, 15.0)]
    sets = [replace(exact[0], force_n=1.02 * exact[0].force_n), exact[1]]
    fit, other = (fits(each, rough, touch_sigma_mm=0.0) for each in (sets, exact))
    low, high = fit.interval_of("nu")
    plain_low, plain_high = fit.solution.profiles["nu"].interval
    assert low <= POISSON <= high
    assert not plain_low <= POISSON <= plain_high
    # What the factor does to the fit, against a fit to forces with it.
    moved = abs(fit.poisson_ratio - other.poisson_ratio)
    assert fit.model_errors["nu"] == pytest.approx(np.sqrt(2) * moved, rel=0.25)
    # One tool cannot tell them from the modulus.
    alone = fits(sets[:1], rough[:1], free_nu=False, touch_sigma_mm=0.0)
    assert alone.model_errors["ln_e"] == pytest.approx(0.02, rel=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("press_cache")
def test_a_narrow_and_a_wide_ball_tell_modulus_and_poisson_ratio() -> None:
    """2 % where one ball leaves 5 to 15 %; the truth is of a finer mesh than the tables."""
    depth, tools = np.linspace(0.1, 1.0, 8), [ball(2.0), ball(15.0)]
    tables = [force_table(replace(gel(), physics=FAST), tool, (0.1, 1.0)) for tool in tools]
    truth = [pressed_n(gel(), tool, depth, POISSON, DEFAULT) * MODULUS / 1e6 for tool in tools]
    rng = np.random.default_rng(5)
    errors, hits = [], np.zeros(2, dtype=int)
    for _ in range(40):
        sets = []
        for tool, force in zip(tools, truth, strict=True):
            touch = 0.02 * rng.standard_normal()
            sets.append(points(tool, depth + touch, force * (1 + 0.01 * rng.standard_normal(8))))
        fit = fits(sets, tables, poisson_ratio=0.46)
        for k, (low, high) in enumerate((fit.young_interval_pa, fit.interval_of("nu"))):
            hits[k] += low <= (MODULUS, POISSON)[k] <= high
        errors.append(fit.young_modulus_pa / MODULUS - 1)
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert (hits >= 36).all()


def test_few_points_tell_no_poisson_ratio_and_noise_stated_too_small_is_noticed() -> None:
    few = DEPTH[[3, 7, 11]]
    profile = fitted(true_n(few) * [1.01, 0.99, 1.005], depth=few).solution.profiles["nu"]
    assert profile.open_low and profile.open_high
    truth = true_n()
    force = truth * (1 + 0.05 * np.random.default_rng(1).standard_normal(12))
    fit = fitted(force, 0.002 * truth, **KNOWN)
    assert fit.noise == "given" and fit.solution.misfit
    low, high = fit.young_interval_pa
    assert low < MODULUS < high


TRAVEL = np.linspace(0.1, 1.0, 10)
PUSH = layer_force_n("sphere", TRAVEL, 4.0, 4.0, 0.48, 3e5)


def read(depth: np.ndarray, force: np.ndarray) -> IndentationPoints:
    tool = ToolEntry(kind="sphere", radius_mm=4.0)
    entry = RecordEntry(file="a.csv", kind="indentation", tool=tool)
    columns = {"depth_mm": depth, "force_n": force}
    return points_of_record(ForceRecord(entry, "folder/a.csv", "0" * 64, columns), gel(), None)


def test_the_closed_form_starts_at_the_modulus_and_soft_gels_in_grams_are_doubted() -> None:
    modulus, remarks = require_plausible([read(TRAVEL, PUSH)], 4.0, 0.48)
    assert modulus == pytest.approx(3e5, rel=1e-6) and not remarks
    _, (remark,) = require_plausible([read(TRAVEL, PUSH / 6 / 9.80665e-3)], 4.0, 0.48)
    assert remark.code == "unusual_modulus" and "grams" in remark.message


@pytest.mark.parametrize(
    ("force", "depth", "unit"),
    [
        (1 / 9.80665e-3, 1.0, "force in grams"),
        (1e3, 1.0, "force in mN"),
        (1.0, 1e-3, "depth in m"),
        (1.5, 0.1, "depth in cm"),
        (1e-3, 1.0, "force in kN"),
    ],
)
def test_a_wrong_unit_is_named(force: float, depth: float, unit: str) -> None:
    with pytest.raises(InputError, match=unit) as error:
        require_plausible([read(TRAVEL * depth, PUSH * force)], 4.0, 0.48)
    assert "1e+07" in str(error.value)


@pytest.mark.parametrize(
    ("depth", "force", "words"),
    [
        (-TRAVEL, PUSH, "no row lies below first touch"),
        (TRAVEL, np.where(TRAVEL < 0.75, 0.0, PUSH), "counted from first touch"),
    ],
)
def test_depths_that_are_not_from_first_touch_are_refused(depth, force, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(depth, force)


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ({"kind": "cylinder"}, "radius of the cylinder is missing"),
        ({"kind": "sphere", "radius_mm": 4.0, "center_mm": (30.0, 0.0)}, "beside the pad"),
        ({"kind": "sphere", "radius_mm": 400.0}, "at most 100 mm"),
        ({"kind": "sphere", "radius_mm": 7.5}, "4 mm thick"),
    ],
)
def test_tools_and_presses_past_the_gel_are_refused(tool: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        force_table(gel(), gel().tool(ToolEntry(**tool)), (0.5, 3.5))


def test_a_tool_may_take_the_radius_of_the_captures_or_be_flat() -> None:
    assert gel().tool(ToolEntry(kind="sphere"), 3.0).radius_mm == 3.0
    assert gel().tool(ToolEntry(kind="flat")).description.startswith("box:")
