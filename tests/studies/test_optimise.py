# SPDX-License-Identifier: Apache-2.0
"""Optimiser-driven sweeps on formulas: optima, constraints, what cannot be reached, replays."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.studies.axis import Axis
from taccel_lab.studies.optimise import METHODS, OptimiserState, optimise, require_method
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.runner import run_study
from taccel_lab.studies.spec import Constraint, Objective, Sweep
from tests.studies.fake_kit import logged, study

X = Axis(Parameter("x", 0.5, "mm", "", "", 0, 4), None, 0, 4)
Y = Axis(Parameter("y", 3.0, "mm", "", "", 0.1, 10), None, 0.1, 10, True)
N = Axis(Parameter("n", 2, "px", "", "", 1, 9), None, 1, 9)
GLOBAL = {"GN_ISRES": 40, "GN_CRS2_LM": 5, "GN_ESCH": 40}
"""Methods that search at random: how far above the least they may end after 150 designs."""


def bowl(values: dict[str, Any]) -> dict[str, float | None]:
    """Least value 500 at x = 1, y = 2."""
    x, y = values.get("x", 1.0), values.get("y", 2.0)
    return {"m": 1000 * ((x - 1) ** 2 + math.log(y / 2) ** 2 + 0.5), "sum": x + y}


def search(
    method: str, constraints: list[Constraint], axes=(X, Y), count: int = 150, figures=bowl
) -> OptimiserState:
    sweep = Sweep(kind="optimize", count=count, method=method)
    return optimise(axes, Objective(minimize="m"), constraints, sweep, 1, figures)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_the_least(method: str) -> None:
    state = search(method, [])
    assert len(state.tried) <= 150 and state.stopped
    best = min(bowl(values)["m"] for values in state.tried)  # type: ignore[type-var]
    assert best <= 500 * (1 + GLOBAL.get(method, 0.2) / 100)  # type: ignore[operator]


@pytest.mark.parametrize("method", ["LN_COBYLA", "LN_SBPLX", "LN_BOBYQA", "GN_ORIG_DIRECT_L"])
def test_constraints_are_kept(method: str) -> None:
    constraint = Constraint(metric="sum", min=4.5)
    state = search(method, [constraint])
    kept = [v for v in state.tried if constraint.violation(v["x"] + v["y"]) < 1e-3]
    best = min(kept, key=lambda v: bowl(v)["m"])  # type: ignore[arg-type,return-value]
    # The least on x + y = 4.5: 788.53 at x = 1.1538, y = 3.3462.
    assert bowl(best)["m"] == pytest.approx(788.53, rel=1e-2)


def test_constraints_that_cannot_be_reached_end_at_the_least_violation() -> None:
    state = search("LN_COBYLA", [Constraint(metric="sum", min=50)])
    assert max(v["x"] + v["y"] for v in state.tried) == pytest.approx(14, rel=1e-3)


def test_designs_are_tried_once_and_counted() -> None:
    calls: list[dict[str, Any]] = []

    def count(values: dict[str, Any]) -> dict[str, float | None]:
        calls.append(values)
        return bowl(values)

    state = search("LN_SBPLX", [], count=12, figures=count)
    assert calls == state.tried and len(calls) == 12
    assert state.stopped == "the count of designs was used up"


def test_whole_numbers_are_tried_once_each() -> None:
    def steps(values: dict[str, Any]) -> dict[str, float | None]:
        return {"m": float((values["n"] - 6) ** 2 + 1)}

    state = search("GN_DIRECT_L", [], axes=(N,), figures=steps)
    tried = [values["n"] for values in state.tried]
    assert len(set(tried)) == len(tried) <= 9 and 6 in tried


def test_designs_that_cannot_be_built_are_walked_around() -> None:
    def holed(values: dict[str, Any]) -> dict[str, float | None]:
        return {"m": None, "sum": None} if values["x"] > 2.5 else bowl(values)

    axes = (Axis(X.parameter, None, 0, 4, start=2.4), Y)
    for constraints in ([], [Constraint(metric="sum", max=9)]):
        state = search("LN_COBYLA", constraints, axes=axes, figures=holed)
        found = [v for v in state.tried if v["x"] <= 2.5]
        assert min(bowl(v)["m"] for v in found) < 505  # type: ignore[type-var,operator]


def test_errors_come_through() -> None:
    def broken(values: dict[str, Any]) -> dict[str, float | None]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search("GN_CRS2_LM", [Constraint(metric="sum", max=9)], figures=broken)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("LN_COBILA", r"is not allowed \(did you mean LN_COBYLA\?\); use one of LN_COBYLA"),
        ("LD_MMA", "needs gradients"),
        ("LN_BOBYQA", "needs two parameters"),
    ],
)
def test_methods_that_cannot_do_it_are_refused(method: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        require_method(method, 1)


OPTIMISE = {
    "parameters": {
        "thickness_mm": {"min": 3, "max": 8, "start": 6},
        "young_modulus_mpa": {"min": 0.05, "max": 1, "scale": "log"},
    },
    "sweep": {"kind": "optimize", "count": 60},
    "objective": {"minimize": "blur"},
}


def test_an_optimised_study_goes_on_where_it_stopped(tmp_path: Path) -> None:
    whole = run_study(study(**OPTIMISE), tmp_path / "whole", processes=0)
    assert whole.complete and len(whole.rows) == whole.total
    best = min(row.figures["blur"] for row in whole.rows)  # type: ignore[type-var]
    assert best == pytest.approx(0.1, abs=0.01)

    parts = tmp_path / "parts"
    stopped = run_study(study(**OPTIMISE), parts, processes=0, limit=7)
    assert not stopped.complete and stopped.new == 7
    resumed = run_study(study(**OPTIMISE), parts, processes=0)
    assert resumed.complete and resumed.new == len(whole.rows) - 7
    assert [row.parameters for row in resumed.rows] == [row.parameters for row in whole.rows]
    assert logged(parts) == logged(tmp_path / "whole")


def test_unreachable_constraints_end_with_a_verdict(tmp_path: Path) -> None:
    bounds = [{"metric": "stiffness", "max": 0.01}]
    outcome = run_study(study(**OPTIMISE, constraints=bounds), tmp_path, processes=0)
    verdict = write_study_report(outcome)["verdict"]
    assert not verdict["good"]
    assert verdict["headline"] == "No design keeps the constraints"
    # The softest and thickest design has stiffness 10 x 0.05 / 8 = 0.0625.
    assert "stiffness at most 0.01 is missed by 0.05" in " ".join(verdict["sentences"])
