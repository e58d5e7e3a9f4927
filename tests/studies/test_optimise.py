# SPDX-License-Identifier: Apache-2.0
"""Sweeps by NLopt and Optuna on formulas: optima, constraints, replays, several processes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.studies.evaluate.optimise import OptimiserState, optimise
from taccel_lab.studies.evaluate.optimise_optuna import JOURNAL, optimise_with_optuna
from taccel_lab.studies.evaluate.runner import default_kit, run_study
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study import read_study
from taccel_lab.studies.spec.study_file import Constraint, Objective, Sweep
from tests.support.fake_kit import logged, study

X = Axis(Parameter("x", 0.5, "mm", "", "", 0, 4), None, 0, 4)
Y = Axis(Parameter("y", 3.0, "mm", "", "", 0.1, 10), None, 0.1, 10, True)
N = Axis(Parameter("n", 2, "px", "", "", 1, 9), None, 1, 9)


def bowl(values: dict[str, Any]) -> dict[str, float | None]:
    """Least value 500 at x = 1, y = 2."""
    x, y = values.get("x", 1.0), values.get("y", 2.0)
    return {"m": 1000 * ((x - 1) ** 2 + math.log(y / 2) ** 2 + 0.5), "sum": x + y}


def search(
    constraints: list[Constraint],
    axes=(X, Y),
    count: int = 150,
    figures=bowl,
    method: Any = "LN_COBYLA",
) -> OptimiserState:
    sweep = Sweep(kind="optimize", count=count, method=method)
    return optimise(axes, Objective(minimize="m"), constraints, sweep, figures)


GOALS = (Objective(minimize="m"), Objective(maximize="sum"))


def by_optuna(
    folder: Path, method: Any, count: int, constraints: Sequence[Constraint] = (), axes=(X, Y),
    attempt=bowl, goals=GOALS, **more: Any,
) -> OptimiserState:  # fmt: skip
    sweep = Sweep(kind="optimize", count=count, method=method)
    return optimise_with_optuna(
        axes, goals, list(constraints), sweep, 1, attempt, journal=folder / JOURNAL, **more
    )


def holed(values: dict[str, Any]) -> dict[str, float | None]:
    """The bowl, of which a part cannot be built."""
    return {"m": None, "sum": None} if values["x"] > 2.5 else bowl(values)


def broken(values: dict[str, Any]) -> dict[str, float | None]:
    raise KeyboardInterrupt


def test_constraints_are_kept() -> None:
    assert best_kept(search([SUM])) == pytest.approx(788.53, rel=1e-2)
    # One that cannot be reached ends at the least violation.
    state = search([Constraint(metric="sum", min=50)])
    assert max(v["x"] + v["y"] for v in state.tried) == pytest.approx(14, rel=1e-3)


SUM = Constraint(metric="sum", min=4.5)
"""The least on x + y = 4.5: 788.53 at x = 1.1538, y = 3.3462."""


def best_kept(state: OptimiserState) -> float:
    kept = [v for v in state.tried if SUM.violation(v["x"] + v["y"]) < 5e-3]
    return min(float(bowl(v)["m"] or 0) for v in kept)


XY = Axis(X.parameter, None, 0.5, 4), Y
"""Above zero, where logarithms are."""


def pressed(values: dict[str, Any]) -> dict[str, float | None]:
    """Powers of thickness x and modulus y near those of a pressed GelSight Mini, and a bend."""
    x, y = values["x"], values["y"]
    return {"m": y**-0.6 * x**0.3, "sum": 2 * y * x**1.2 / (1 + x / 40)}


def test_slopes_lead_to_the_optimum_in_half_of_cobylas_simulations() -> None:
    most = Constraint(metric="m", max=0.8)

    def found(method: Any) -> list[dict[str, Any]]:
        sweep = Sweep(kind="optimize", count=40, method=method, tolerance=0.01)
        return optimise(XY, Objective(minimize="sum"), [most], sweep, pressed).tried

    slopes, without = found("LD_SLSQP"), found("LN_COBYLA")
    least = min(float(pressed(v)["sum"] or 0) for v in (*slopes, *without) if kept(v, most))

    def simulations(tried: list[dict[str, Any]]) -> int:
        near = (kept(v, most) and float(pressed(v)["sum"] or 0) < 1.01 * least for v in tried)
        first = next((number for number, ok in enumerate(near, 1) if ok), len(tried))
        # Designs that differ in the modulus alone share one.
        return len({v["x"] for v in tried[:first]})

    assert simulations(slopes) <= 0.5 * simulations(without)
    assert min(bowl(v)["m"] or 0 for v in search([], XY, method="LD_SLSQP").tried) < 510


def kept(values: dict[str, Any], constraint: Constraint) -> bool:
    return constraint.violation(float(pressed(values)["m"] or 0)) <= 1e-3 * 0.8


@pytest.mark.parametrize(
    ("axes", "figures"),
    [
        ((X, N), lambda v: {"m": bowl({"x": v["x"]})["m"], "sum": v["n"] + v["x"]}),
        (XY, lambda v: {"m": 700.0, "sum": v["x"] + v["y"]}),
        (XY, lambda v: {"m": None, "sum": 9.0} if v["x"] > 2 else bowl(v)),
    ],
)
def test_cobyla_goes_on_where_figures_have_no_slope(axes: Any, figures: Any) -> None:
    found = search([SUM], axes, figures=figures, method="LD_SLSQP")
    least = search([SUM], axes, figures=figures).tried
    kept = [v for v in (*found.tried, *least) if SUM.violation(figures(v)["sum"] or 0) < 5e-3]
    best = min(float(figures(v)["m"] or math.inf) for v in kept)
    mine = [float(figures(v)["m"] or math.inf) for v in kept if v in found.tried]
    assert min(mine) <= 1.02 * best


def test_neighbours_are_evaluated_together_and_counted() -> None:
    asked: list[int] = []
    sweep = Sweep(kind="optimize", count=7, method="LD_SLSQP")
    state = optimise(
        XY, Objective(minimize="m"), [], sweep, bowl, lambda designs: asked.append(len(designs))
    )
    assert asked[:3] == [3, 3, 1] and len(state.tried) == 7
    assert state.stopped == "the count of designs was used up"


@pytest.mark.thorough(cases=("GP-700-12",))
@pytest.mark.parametrize(
    ("method", "least", "most"), [("GP", 700, 12), ("TPE", 1000, 12), ("NSGA2", 2000, 11)]
)
def test_every_method_of_optuna_spreads_along_the_front(
    tmp_path: Path, method: str, least: float, most: float
) -> None:
    state = by_optuna(tmp_path, method, 18 if method == "GP" else 40)
    assert min(float(bowl(v)["m"] or 0) for v in state.tried) < least
    assert max(v["x"] + v["y"] for v in state.tried) > most
    assert state.stopped == "the count of designs was used up"


@pytest.mark.thorough
def test_gp_keeps_constraints_and_goes_on_from_rows_without_its_journal(tmp_path: Path) -> None:
    goals = (Objective(minimize="m"), Objective(minimize="sum"))
    calls: list[dict[str, Any]] = []

    def counted(values: dict[str, Any]) -> dict[str, float | None]:
        calls.append(values)
        return bowl(values)

    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    first = by_optuna(tmp_path / "a", "GP", 12, [SUM], goals=goals)
    rows = [(v, bowl(v)) for v in first.tried]
    whole = by_optuna(
        tmp_path / "b", "GP", 20, [SUM], goals=goals, attempt=counted, known=lambda: rows
    )
    assert len(whole.tried) == 20 and len(calls) == 8
    assert best_kept(whole) == pytest.approx(788.53, rel=0.03)


@pytest.mark.thorough
def test_designs_without_a_figure_are_no_end(tmp_path: Path) -> None:
    assert len(by_optuna(tmp_path, "GP", 15, attempt=holed).tried) == 15


def test_designs_are_tried_once_and_counted() -> None:
    calls: list[dict[str, Any]] = []
    state = search([], count=12, figures=lambda values: calls.append(values) or bowl(values))
    assert calls == state.tried and len(calls) == 12
    assert state.stopped == "the count of designs was used up"


def test_whole_numbers_are_tried_once_each(tmp_path: Path) -> None:
    def steps(values: dict[str, Any]) -> dict[str, float | None]:
        return {"m": float((values["n"] - 6) ** 2 + 1), "sum": values["n"]}

    state = by_optuna(tmp_path, "TPE", 20, axes=(N,), attempt=steps)
    tried = [values["n"] for values in state.tried]
    assert len(set(tried)) == len(tried) <= 9 and 6 in tried
    assert state.stopped == "designs repeated themselves"


def test_designs_that_cannot_be_built_are_walked_around() -> None:
    axes = (Axis(X.parameter, None, 0, 4, start=2.4), Y)
    for constraints in ([], [Constraint(metric="sum", max=9)]):
        state = search(constraints, axes=axes, figures=holed)
        found = [v for v in state.tried if v["x"] <= 2.5]
        assert min(bowl(v)["m"] for v in found) < 505  # type: ignore[type-var,operator]


def test_an_interrupted_try_is_no_design(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        search([Constraint(metric="sum", max=9)], figures=broken)
    with pytest.raises(KeyboardInterrupt):
        by_optuna(tmp_path, "TPE", 5, attempt=broken)
    assert len(by_optuna(tmp_path, "TPE", 5).tried) == 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sweep": {"kind": "optimize", "count": 9, "method": "LN_COBILA"}}, "LN_COBYLA"),
        ({"sweep": {"kind": "optimize", "count": 9, "method": "GP", "tolerance": 0.1}}, "belongs"),
        ({"objective": None, "objectives": [{"minimize": "blur"}, {"maximize": "range"}]}, "GP, T"),
        ({"objectives": [{"minimize": "blur"}]}, "either .objective. or"),
        ({"sweep": {"kind": "optimize", "count": 9, "method": "GP"}},
         "'GP' takes several objectives; one is for LD_SLSQP or LN_COBYLA"),
    ],
)  # fmt: skip
def test_methods_that_cannot_do_it_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        study(**{**OPTIMISE, **changes})


OPTIMISE = {
    "parameters": {
        "thickness_mm": {"min": 3, "max": 8, "start": 6},
        "young_modulus_mpa": {"min": 0.05, "max": 1, "scale": "log"},
    },
    "sweep": {"kind": "optimize", "count": 60},
    "objective": {"minimize": "blur"},
}


@pytest.mark.thorough
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


@pytest.mark.parametrize(
    ("name", "method"),
    [("mini_optimised", "LD_SLSQP"), ("led_angles", "LN_COBYLA"), ("softest_gel", "LN_COBYLA")],
)
def test_slopes_are_the_default_for_smooth_figures_alone(name: str, method: str) -> None:
    examples = Path(__file__).parents[2] / "taccel_lab" / "studies" / "examples"
    assert read_study(examples / f"{name}.toml", default_kit()).spec.sweep.method == method
