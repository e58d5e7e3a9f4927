# SPDX-License-Identifier: Apache-2.0
"""What limits the best design, and between which values its parameters are known."""

from __future__ import annotations

from typing import Any

import pytest

from taccel_lab.cad.parameters import Parameter
from taccel_lab.studies.evaluate.design_row import DesignRow, ranked
from taccel_lab.studies.report.answer import Answer, answer
from taccel_lab.studies.report.sensitivity import sensitivity
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study_file import Constraint, Objective

STIFFNESS = Objective(minimize="stiffness")


def axis(name: str, low: float, high: float) -> Axis:
    return Axis(Parameter(name, 3.0, "mm", "thickness", "a test"), None, low, high)


def answered(
    constraints: list[Constraint],
    ends: tuple[float, float] = (1.0, 1.0),
    goal: Objective = STIFFNESS,
    thicknesses: tuple[float, ...] = (2.0, 2.5, 3.0, 4.0, 4.05, 5.0),
) -> Answer:
    """Of gels with stiffness 12 / t and range 2 t^2, whose range is known to within ``ends``."""
    rows = []
    for k, t in enumerate(thicknesses):
        reach = 2 * t**2
        values: dict[str, Any] = {"stiffness": 12 / t, "range": reach}
        known = {"range": [reach * ends[0], reach * ends[1]]}
        rows.append(
            DesignRow(str(k), "gelsight", {"thickness_mm": t}, "done", values, intervals=known)
        )
    columns = {"thickness_mm": [row.parameters["thickness_mm"] for row in rows]}
    found = {
        name: sensitivity(columns, [row.figures[name] for row in rows], grid=False)
        for name in ("stiffness", "range")
    }
    best = ranked(rows, goal, constraints)[0]
    return answer(best, rows, goal, constraints, [axis("thickness_mm", 2.0, 5.0)], found)


def test_a_constraint_that_every_better_design_breaks_limits_it() -> None:
    found = answered([Constraint(metric="range", max=33.0)])
    assert found.design == "4"
    assert [limit.name for limit in found.limits] == ["range"]
    assert found.limits[0].text == "range at most 33"
    # 4.05 and 4.0 mm differ by 1.2 %, which no press tells apart; 2 t^2 is 33 at 4.062 mm.
    assert found.intervals["thickness_mm"] == pytest.approx((4.0, 16.5**0.5))


def test_gels_that_may_be_softer_or_stiffer_widen_the_range() -> None:
    found = answered([Constraint(metric="range", max=33.0)], ends=(0.8, 1.25))
    best = 2 * 4.05**2
    low, high = found.intervals["thickness_mm"]
    # The range is 2 t^2: the elasticity is 2.
    assert low == pytest.approx(4.05 * (33.0 / (1.25 * best)) ** 0.5)
    assert high == pytest.approx(4.05 * (33.0 / (0.8 * best)) ** 0.5)


def test_the_range_stays_inside_what_was_swept() -> None:
    found = answered([Constraint(metric="range", max=33.0)], ends=(0.1, 10.0))
    assert found.intervals["thickness_mm"] == (2.0, 5.0)


def test_the_end_of_a_range_limits_it_where_no_constraint_does() -> None:
    assert [limit.text for limit in answered([]).limits] == ["thickness_mm, whose range ends at 5"]
    stiffest = answered([], goal=Objective(maximize="stiffness"))
    assert "ends at 2" in stiffest.limits[0].text


def test_an_optimum_inside_has_no_limit() -> None:
    assert answered([], thicknesses=(2.0, 3.0, 4.0)).limits == ()
