# SPDX-License-Identifier: Apache-2.0
"""What indentations leave open is in the intervals: of the modulus, of forces, of held-out points.

Records are made up from the tables themselves: what is asked is whether intervals hold what the
points do not tell, not whether simulations agree.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.force_table import ForceTable, TableError
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.indentation_points import IndentationPoints
from taccel_lab.calibration.material.stiffness import KnownLaw, Stiffness, fit_stiffness
from taccel_lab.report.remark import Severity, Verdict, judge
from tests.calibration.material.made_up import layer_table, points

MODULUS, HELD = 3e5, 0.46
FEW = np.array([0.4, 0.7, 1.0])
MANY = np.linspace(0.2, 1.2, 10)


@pytest.fixture(scope="module")
def tool(gel: Gel) -> Tool:
    return gel.tool(ToolEntry(kind="sphere", radius_mm=5.0))


@pytest.fixture(scope="module")
def table() -> ForceTable:
    return layer_table("sphere", 5.0)


def rubbed(table: ForceTable) -> ForceTable:
    """As if friction made presses stiffer, the deeper the more."""
    coefficients = table.responses.coefficients.copy()
    coefficients[0, 0] += 0.15 * np.exp(table.responses.way) / np.exp(table.responses.way)[-1]
    responses = replace(table.responses, coefficients=coefficients)
    return replace(table, responses=responses, error=TableError(0.0, np.zeros(1)))


def fitted(given: IndentationPoints, tables: dict[float, ForceTable], **law: bool) -> Stiffness:
    known = KnownLaw(HELD, 0.0, law.get("free_nu", True), False)
    every = {mu: [table] for mu, table in tables.items()}
    return fit_stiffness([given], every, known, start_pa=4e5)


def inside(interval: tuple[float, float], value: float) -> bool:
    return interval[0] <= value <= interval[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depths", "zero_mm", "noise"),
    [(FEW, 0.05, 0.01), (MANY, 0.1, 0.01), (MANY, 0.0, 0.03)],
    ids=["few", "late zero", "noisy"],
)
def test_intervals_hold_what_the_points_do_not_tell(
    tool: Tool, table: ForceTable, depths: np.ndarray, zero_mm: float, noise: float
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
        found = fitted(points(tool, depths, read[:-1]), {0.0: table})
        force = float(table.force_n(np.array([deeper]), MODULUS, nu)[0])
        hits[0] += inside(found.young.interval95, MODULUS)
        hits[1] += inside(found.force_interval_n(0, deeper), force)
        hits[2] += inside(found.reading_interval_n(0, deeper), float(read[-1]))
    # Of 40 that are in an interval of 95 % each, fewer than 34 would be 1 case in 300.
    assert (hits >= 34).all(), hits


def test_held_out_points_lie_in_their_intervals(tool: Tool, table: ForceTable) -> None:
    rng = np.random.default_rng(7)
    hits = []
    for _ in range(4):
        nu = rng.uniform(0.42, 0.495)
        force = table.force_n(MANY - 0.05 * rng.standard_normal(), MODULUS, nu)
        found = fitted(points(tool, MANY, force * (1 + 0.02 * rng.normal(size=10))), {0.0: table})
        assert len(found.held_out) == len(MANY)
        hits += [inside(item.interval_n, item.force_n) for item in found.held_out]
    assert sum(hits) >= 36  # of 40


def test_few_points_that_fit_are_not_called_good(tool: Tool, table: ForceTable) -> None:
    found = fitted(points(tool, FEW, table.force_n(FEW, MODULUS, 0.48)), {0.0: table})
    assert np.abs(found.fit.relative_residuals(0)).max() < 0.01
    (said,) = [remark for remark in found.remarks if remark.code == "too_few"]
    assert said.severity is Severity.WARNING and "3 points and 2 fitted numbers" in said.message
    assert judge(found.remarks) is not Verdict.GOOD
    many = fitted(points(tool, MANY, table.force_n(MANY, MODULUS, 0.48)), {0.0: table})
    assert "too_few" not in {remark.code for remark in many.remarks}


def test_points_choose_the_friction_that_explains_them(tool: Tool, table: ForceTable) -> None:
    tables = {0.0: table, 0.8: rubbed(table)}
    rng = np.random.default_rng(1)
    for mu, source in tables.items():
        force = source.force_n(MANY, MODULUS, HELD) * (1 + 0.005 * rng.standard_normal(10))
        found = fitted(points(tool, MANY, force), tables, free_nu=False)
        assert found.friction == mu
        assert found.young.value == pytest.approx(MODULUS, rel=0.03)
        (said,) = [remark for remark in found.remarks if remark.code == "friction_assumed"]
        assert f"coefficient of {mu:g}" in said.message and said.severity is Severity.WARNING
    alone = fitted(points(tool, MANY, force), {0.8: tables[0.8]}, free_nu=False)
    assert "friction_assumed" not in {remark.code for remark in alone.remarks}


def test_friction_that_points_do_not_tell_widens_intervals(tool: Tool, table: ForceTable) -> None:
    force = table.force_n(FEW, MODULUS, HELD) * [1.01, 0.99, 1.005]
    given = points(tool, FEW, force)
    alone = fitted(given, {0.0: table}, free_nu=False)
    both = fitted(given, {0.0: table, 0.8: rubbed(table)}, free_nu=False)
    assert len(both.open_fits) == 2
    (low, high), (narrow_low, narrow_high) = both.young.interval95, alone.young.interval95
    assert low < 0.97 * narrow_low and high == pytest.approx(narrow_high, rel=0.02)


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_a_force_at_a_recorded_depth_allows_for_the_zero(
    gel: Gel, tool: Tool, table: ForceTable, kind: Literal["sphere", "cylinder"]
) -> None:
    """First touch shifts what a record calls a depth, and not what a press calls one."""
    used = gel.tool(ToolEntry(kind=kind, radius_mm=5.0))
    force = table.force_n(MANY - 0.1, MODULUS, HELD)
    found = fitted(points(used, MANY, force), {0.0: table}, free_nu=False)
    assert found.fit.touch_mm(0) == pytest.approx(0.1, abs=5e-3)
    recorded = found.reading_interval_n(0, 0.8)
    assert inside(recorded, float(table.force_n(np.array([0.7]), MODULUS, HELD)[0]))
    assert inside(
        found.force_interval_n(0, 0.8), float(table.force_n(np.array([0.8]), MODULUS, HELD)[0])
    )
    assert recorded[1] < found.force_interval_n(0, 0.8)[1]
