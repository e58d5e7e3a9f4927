# SPDX-License-Identifier: Apache-2.0
"""Runs of studies: rows, resumption, changed study files, lost designs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.output_folder import require_replaceable
from taccel_lab.studies.evaluate.runner import Listener, read_outcome, run_study
from taccel_lab.studies.evaluate.study_folder import STUDY_MARKER, write_table
from tests.support.fake_kit import evaluate, evaluate_and_crash, figures_of, logged, study, table


class Recorder(Listener):
    def __init__(self) -> None:
        self.told: list[tuple[Any, ...]] = []

    def begins(self, total: int, there: int, to_do: int) -> None:
        self.told.append((total, there, to_do))

    def finished(self, design: Any) -> None:
        self.told.append((design.id, design.status))


def rows_of(root: Path) -> list[dict[str, str]]:
    with open(root / "designs.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_design_has_a_row_with_its_figures(tmp_path: Path) -> None:
    recorder = Recorder()
    planned = study(constraints=[{"metric": "range", "min": 10}])
    outcome = run_study(planned, tmp_path, processes=0, listener=recorder, source="# text\n")
    assert outcome.complete and outcome.new == outcome.total == 6
    rows = rows_of(tmp_path)
    assert [row["design"] for row in rows] == [p.id for p in planned.points()]
    assert list(rows[0]) == [
        "thickness_mm", "young_modulus_mpa",
        *(n + end for n in ("stiffness", "range", "blur") for end in ("", " low", " high")),
        "feasible", "status", "cause", "simulations", "seconds", "design",
    ]  # fmt: skip
    for row, point in zip(rows, planned.points(), strict=True):
        figures = figures_of(point.parameters)
        assert all(float(row[name]) == figures[name] for name in ("stiffness", "range", "blur"))
        assert row["feasible"] == ("true" if figures["range"] >= 10 else "false")
    assert recorder.told[0] == (6, 0, 6) and len(recorder.told) == 7
    assert (tmp_path / "study.toml").read_text() == "# text\n"
    # Other commands do not take a study for their output.
    assert (tmp_path / STUDY_MARKER).is_file()
    with pytest.raises(InputError):
        require_replaceable(tmp_path)


def test_rows_that_are_there_are_not_evaluated_again(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no study"):
        read_outcome(study(), tmp_path)
    run_study(study(), tmp_path, processes=0, limit=2)
    stored = read_outcome(study(), tmp_path)
    assert len(stored.rows) == len(rows_of(tmp_path)) == len(logged(tmp_path)) == 2
    assert not stored.complete
    outcome = run_study(study(), tmp_path, processes=0)
    assert outcome.complete and outcome.new == 4
    assert run_study(study(), tmp_path, processes=0).new == 0
    assert sorted(logged(tmp_path)) == sorted(p.id for p in study().points())
    # Added values extend it; rows of others are kept.
    wider: dict[str, Any] = {
        "thickness_mm": {"values": [3.0, 4.0, 5.0, 6.0]}, "young_modulus_mpa": {"values": [0.1]},
    }  # fmt: skip
    outcome = run_study(study(parameters=wider), tmp_path, processes=0)
    assert outcome.new == 1 and outcome.others == 3 and len(rows_of(tmp_path)) == 4
    assert run_study(study(), tmp_path, processes=0).new == 0


def test_no_figure_gets_lost(tmp_path: Path) -> None:
    """Neither when metrics are added, nor when fewer are asked for."""
    few = {**table()["study"], "metrics": ["stiffness"]}
    for changes in ({"study": few}, {}, {"study": few}):
        run_study(study(**changes), tmp_path, processes=0)
    outcome = read_outcome(study(), tmp_path)
    assert outcome.complete and len(outcome.rows) == 6
    for row in outcome.rows:
        known = figures_of(row.parameters)
        assert row.figures == {name: known[name] for name in ("stiffness", "range", "blur")}
        assert row.simulations == 3 and set(row.curves) == {"ball", "edge"}
    assert len(logged(tmp_path)) == 2 * 6


@pytest.mark.thorough
def test_new_metrics_leave_known_figures_alone(tmp_path: Path) -> None:
    asked: list[tuple[list[str], list[str]]] = []

    def spy(designs, presses, metrics, **rest):
        asked.append(([p.name for p in presses], [m.name for m in metrics]))
        return evaluate(designs, presses, metrics, **rest)

    few = {**table()["study"], "metrics": ["stiffness"]}
    for changes, wanted in (
        ({"study": few}, [(["ball"], ["stiffness"])] * 3),
        ({"study": {**few, "metrics": ["lamps", "stiffness"]}}, [([], ["lamps"])] * 3),
        ({}, [(["ball", "edge"], ["range", "blur"])] * 3),
        ({"press": {"edge": {"depth_mm": 0.5}}}, [(["edge"], ["blur"])] * 3),
        ({"study": few}, []),
    ):
        asked.clear()
        run_study(study(spy, **changes), tmp_path, processes=0)
        assert asked == wanted
        if not changes:
            row = rows_of(tmp_path)[0]
            assert row["simulations"] == "3" and row["stiffness"] and row["blur"]


RIMS = {"rim": {"values": ["none", "chamfer", "fillet"]}}


def test_designs_without_figures_are_rows_with_causes(tmp_path: Path) -> None:
    assert run_study(study(parameters=RIMS), tmp_path / "a", processes=0).complete
    rows = rows_of(tmp_path / "a")
    assert [row["status"] for row in rows] == ["done", "done", "failed"]
    causes = [row["cause"] for row in rows]
    assert causes == ["", "blur: no edge was found", "the fillet does not fit"]
    assert rows[1]["blur"] == "" and rows[1]["range"] != ""
    assert run_study(study(parameters=RIMS), tmp_path / "a", processes=0).new == 0
    # Parameters that contradict each other are a row, too.
    thin = {"thickness_mm": {"values": [1.6, 5.0]}}
    outcome = run_study(study(parameters=thin), tmp_path / "b", processes=0)
    assert [row.status for row in outcome.rows] == ["failed", "done"]
    assert "thickness_mm" in outcome.rows[0].cause


@pytest.mark.thorough
def test_one_fault_and_one_dead_process_cost_one_row_each(tmp_path: Path) -> None:
    planned = study(evaluate_and_crash, study={**table()["study"], "metrics": ["stiffness"]})
    outcome = run_study(planned, tmp_path, processes=2)
    assert [row.status for row in outcome.rows] == ["broken"] * 2 + ["done"] * 2 + ["broken"] * 2
    causes = [row.cause for row in outcome.rows]
    assert causes[0] == "ZeroDivisionError: a fault of the program"
    assert "signal 9" in causes[4]
    trace = tmp_path / "designs" / outcome.rows[0].id / "traceback.txt"
    assert "evaluate_and_crash" in trace.read_text()
    # The next run tries them again, and nothing else.
    again = run_study(study(), tmp_path, processes=0)
    assert {row.status for row in again.rows} == {"done"}
    assert len(logged(tmp_path)) == 2 + 6


def test_a_study_of_another_sensor_is_refused(tmp_path: Path) -> None:
    run_study(study(), tmp_path, processes=0, limit=1)
    other = study(
        study={**table()["study"], "sensor": "digit"},
        parameters={"thickness_mm": {"values": [4.0]}},
    )
    with pytest.raises(InputError, match="holds a study of the sensor 'gelsight', not of 'digit'"):
        run_study(other, tmp_path, processes=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[:-30], "is not valid JSON"),
        (lambda text: "[]", r"holds \[\]; a table"),
        (lambda text: "[" * 100_000, "is nested more than 32 deep"),
        (lambda text: '{"id": "x"}', "is damaged: keys .* are missing"),
        ({"figures": 3}, "is damaged: figures is 3"),
        ({"figures": {"blur": True}}, r"is damaged: figures\.blur is True"),
        ({"causes": {"blur": 2}}, r"is damaged: causes\.blur is 2"),
        ({"seconds": "1"}, "is damaged: seconds is '1'"),
        ({"files": {"mesh": "../x"}}, "is damaged: .* leads out of it"),
        (lambda text: None, "is that of another design"),
    ],
)
def test_damaged_results_are_named(tmp_path: Path, change: Any, words: str) -> None:
    outcome = run_study(study(), tmp_path, processes=0)
    path, other = (outcome.folder.design(row.id) / "result.json" for row in outcome.rows[:2])
    text = path.read_text()
    bad = json.dumps({**json.loads(text), **change}) if isinstance(change, dict) else change(text)
    path.write_text(other.read_text() if bad is None else bad)
    with pytest.raises(InputError, match=rf"result\.json {words}"):
        run_study(study(), tmp_path, processes=0)
    path.unlink()
    assert run_study(study(), tmp_path, processes=0).new == 1


def test_parquet_has_the_same_rows(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    outcome = run_study(study(parameters=RIMS), tmp_path, processes=0)
    write_table(tmp_path, outcome.study, outcome.rows)
    columns = parquet.read_table(tmp_path / "designs.parquet").to_pydict()
    assert list(columns) == list(rows_of(tmp_path)[0])
    assert columns["rim"] == ["none", "chamfer", "fillet"]
    assert columns["blur"][1:] == [None, None]
