# SPDX-License-Identifier: Apache-2.0
"""Study files: what is refused, and what the message says."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.studies.spec import Constraint, load_spec, spec_of
from tests.support.fake_kit import table

EXAMPLES = sorted((Path(__file__).parents[2] / "studies" / "examples").glob("*.toml"))


def changed(path: str, value: Any) -> dict[str, Any]:
    """The fake study with one key set, or taken away where the value is ``...``."""
    result = copy.deepcopy(table())
    *tables, key = path.split("/")
    place: Any = result
    for name in tables:
        place = place.setdefault(name, {})
    if value is ...:
        del place[key]
    else:
        place[key] = value
    return result


BAD = [
    ("swep", {}, "swep: unknown key; allowed:", "did you mean sweep?"),
    ("study/nam", "x", "study.nam: unknown key; allowed: name, sensor", "did you mean name?"),
    ("study/metrics", [], "no metrics: name at least one in study.metrics"),
    ("study/metrics", ["blur", "blur"], "named twice: blur"),
    ("study/name", ..., "study.name: field required"),
    ("study/seed", -1, "study.seed", "found -1"),
    ("sweep", ..., "sweep: field required"),
    ("sweep/kind", "gird", "'grid', 'random' or 'optimize'", "found 'gird'"),
    ("sweep/count", 3, "a grid has as many designs as its values make"),
    ("sweep/kind", "random", "needs count"),
    ("sweep/sampler", "sobol", "sampler belongs to kind = 'random'"),
    ("parameters", {}, "there is nothing to sweep"),
    ("parameters/thickness_mm", {"values": []}, "values is empty"),
    ("parameters/thickness_mm", {"values": [3, 3]}, "values repeat themselves"),
    ("parameters/thickness_mm", {"values": [True]}, "must be a finite number or a text"),
    ("parameters/thickness_mm", {"values": [float("inf")]}, "must be a finite number or a text"),
    ("parameters/thickness_mm", {"values": [3], "min": 2}, "not both"),
    ("parameters/thickness_mm", {"min": 2}, "give values = [...], or min and max"),
    ("parameters/thickness_mm", {"min": 5, "max": 3, "count": 2}, "min 5 must be below max 3"),
    ("parameters/thickness_mm", {"min": 2, "max": 3}, "a range in a grid needs count"),
    ("parameters/thickness_mm", {"min": 2, "max": 3, "count": 0}, "greater than or equal to 1"),
    ("parameters/thickness_mm", {"min": 0, "max": 3, "count": 2, "scale": "log"}, "min above 0"),
    ("parameters/thickness_mm", {"min": 2, "max": 3, "count": 2, "start": 2}, "start belongs to"),
    ("parameters/thickness_mm", {"vales": [3]}, "unknown key", "did you mean values?"),
    ("fixed", {"thickness_mm": 3}, "thickness_mm stands in [fixed] and in [parameters]"),
    ("tied", {"rim_mm": {"to": "thickness"}}, "'thickness' is not swept; swept are thickness_mm"),
    ("objective", {}, "either minimize or maximize"),
    ("objective", {"minimize": "blur", "maximize": "range"}, "either minimize or maximize"),
    ("constraints", [{"metric": "blur"}], "constraints.0: give min, max or both"),
    ("constraints", [{"metric": "blur", "min": 2, "max": 1}], "unreachable: min 2 is above max 1"),
    ("constraints", [{"metric": "blur", "min": 1}, {"metric": "blur", "max": 2}], "one metric"),
    ("constraints", [{"metric": "blur", "most": 2}], "constraints.0.most: unknown key", "min, max"),
    ("output", {"steps": True}, "output.steps: unknown key", "did you mean step?"),
    ("run", {"processes": 0}, "run.processes", "found 0"),
    ("run", {"processes": True}, "run.processes: input should be a valid integer (found True)"),
    ("study/load_n", "0.5", "study.load_n: input should be a valid number (found '0.5')"),
    ("study/seed", True, "study.seed: input should be a valid integer (found True)"),
    ("output", {"step": "no"}, "output.step: input should be a valid boolean (found 'no')"),
    ("constraints", [{"metric": "blur", "max": True}], "input should be a valid number"),
    ("self", {}, "self: unknown key"),
    ("model_config", {}, "model_config: unknown key"),
]


@pytest.mark.parametrize(("path", "value", "texts"), [(p, v, t) for p, v, *t in BAD])
def test_bad_studies_are_refused_with_what_is_allowed(path: str, value: Any, texts: list[str]):
    with pytest.raises(InputError) as caught:
        spec_of(changed(path, value), "my.toml")
    assert all(line.startswith("my.toml: ") for line in str(caught.value).splitlines())
    for text in texts:
        assert text in str(caught.value)


def test_every_fault_has_a_line() -> None:
    bad = changed("study/seed", -1)
    bad["sweep"] = {"kind": "gird"}
    with pytest.raises(InputError) as caught:
        spec_of(bad)
    assert len(str(caught.value).splitlines()) == 2


@pytest.mark.parametrize("ranges", [{"values": [3.0]}, {"min": 2, "max": 3, "count": 2}])
def test_optimiser_wants_ranges_without_counts(ranges: dict[str, Any]) -> None:
    bad = table(parameters={"thickness_mm": ranges}, sweep={"kind": "optimize", "count": 5})
    bad["objective"] = {"minimize": "blur"}
    with pytest.raises(InputError, match=r"an optimiser needs min and max|count belongs to a grid"):
        spec_of(bad)


def test_optimiser_needs_an_objective() -> None:
    parameters = {"thickness_mm": {"min": 2, "max": 3}}
    with pytest.raises(InputError, match=r"needs \[objective\]"):
        spec_of(table(parameters=parameters, sweep={"kind": "optimize", "count": 5}))


def test_objective_and_constraints_are_measured_too() -> None:
    spec = spec_of(
        table(
            study={"name": "a", "sensor": "gelsight"},
            objective={"maximize": "range"},
            constraints=[{"metric": "blur", "max": 2}],
        )
    )
    assert spec.metrics() == ("range", "blur")


def test_violation_is_the_distance_to_the_nearer_bound() -> None:
    constraint = Constraint(metric="blur", min=1, max=2)
    assert [constraint.violation(value) for value in (0.25, 1, 1.5, 2, 4)] == [0.75, 0, 0, 0, 2]
    assert constraint.text() == "blur from 1 to 2"


def test_files_are_named_in_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml does not exist"):
        load_spec(tmp_path / "none.toml")
    path = tmp_path / "bad.toml"
    path.write_text("[study\n")
    with pytest.raises(InputError, match=r"bad\.toml is not valid TOML"):
        load_spec(path)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_sound(path: Path) -> None:
    from taccel_lab.studies.study import default_kit, make_study

    study = make_study(load_spec(path), default_kit())
    if study.spec.sweep.kind != "optimize":
        for point in study.points():
            study.family.parameters(point.parameters)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 4
