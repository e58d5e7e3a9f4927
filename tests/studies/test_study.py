# SPDX-License-Identifier: Apache-2.0
"""Studies: what files say wrong, the catalogue's names and bounds, ties, grids, random sweeps."""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab import studies
from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.studies.evaluate.batches import MAX_BATCH, DesignBatch, gather_batches
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.spec.axis import Axis, axis_of, random_points
from taccel_lab.studies.spec.study import make_study
from taccel_lab.studies.spec.study_file import Constraint, ParameterRange, load_spec, spec_of
from tests.support.fake_kit import study, table

# Files --------------------------------------------------------------------------------------------


EXAMPLES = sorted(Path(studies.__file__).parent.glob("examples/*.toml"))


def changed(path: str, value: Any) -> dict[str, Any]:
    """The fake study with one key set, or taken away where the value is ``...``."""
    result = copy.deepcopy(table())
    *tables, key = path.split("/")
    place: Any = result
    for name in tables:
        place = place.setdefault(name, {})
    place[key] = value
    if value is ...:
        del place[key]
    return result


BAD_FILES = [
    ("swep", {}, "swep: unknown key (did you mean sweep?)"),
    ("study/nam", "x", "study.nam: unknown key (did you mean name?); allowed: name, sensor"),
    ("study/metrics", [], "no metrics: name at least one in study.metrics"),
    ("study/metrics", ["blur", "blur"], "named twice: blur"),
    ("study/name", ..., "study.name: field required"),
    ("study/seed", -1, "study.seed", "found -1"),
    ("sweep", {}, "sweep.kind: field required"),
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
    ("run", {"processes": 0}, "run.processes", "found 0"),
]


@pytest.mark.parametrize(("path", "value", "texts"), [(p, v, t) for p, v, *t in BAD_FILES])
def test_bad_studies_are_refused_with_what_is_allowed(path: str, value: Any, texts: list[str]):
    with pytest.raises(InputError) as caught:
        spec_of(changed(path, value), "my.toml")
    assert all(line.startswith("my.toml: ") for line in str(caught.value).splitlines())
    for text in texts:
        assert text in str(caught.value)


RANGE = {"thickness_mm": {"min": 2, "max": 3}}
OPTIMIZE = {"sweep": {"kind": "optimize", "count": 5}}
BLUR = {"objective": {"minimize": "blur"}}


@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({"parameters": {"thickness_mm": {"values": [3.0]}}, **OPTIMIZE, **BLUR}, ["min and max"]),
        ({"parameters": {"thickness_mm": {"min": 2, "max": 3, "count": 2}}, **OPTIMIZE, **BLUR},
         ["count belongs to a grid"]),
        ({"parameters": RANGE, **OPTIMIZE}, [r"needs \[objective\]"]),
        # Every fault has a line.
        ({"study": {**table()["study"], "seed": -1}, "sweep": {"kind": "gird"}}, ["-1", "gird"]),
    ],
)  # fmt: skip
def test_tables_that_do_not_go_together_are_refused(changes: dict, messages: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        spec_of(table(**changes))
    lines = str(caught.value).splitlines()
    for line, message in zip(lines, messages, strict=True):
        assert re.search(message, line)


def test_objective_and_constraints_are_measured_too() -> None:
    given = {"objective": {"maximize": "range"}, "constraints": [{"metric": "blur", "max": 2}]}
    spec = spec_of(table(study={"name": "a", "sensor": "gelsight"}, **given))
    assert spec.metrics() == ("range", "blur")
    constraint = Constraint(metric="blur", min=1, max=2)
    assert [constraint.violation(value) for value in (0.25, 1, 1.5, 2, 4)] == [0.75, 0, 0, 0, 2]
    assert constraint.text() == "blur from 1 to 2"


def test_without_a_word_on_the_sweep_it_is_a_grid() -> None:
    assert spec_of(changed("sweep", ...)).sweep.kind == "grid"


@pytest.mark.thorough(cases=("digit_curvature", "mini_thickness_hardness"))
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_sound(path: Path) -> None:
    study = make_study(load_spec(path), default_kit())
    if study.spec.sweep.kind != "optimize":
        for point in study.points():
            study.family.parameters(point.parameters)


# Against the catalogue ----------------------------------------------------------------------------


WIDE = {"min": 300, "max": 900}
BAD: list[tuple[dict[str, Any], str]] = [
    ({"study": {**table()["study"], "sensor": "gelsigt"}}, r"no sensor 'gelsigt' \(did you mean"),
    (
        {"study": {**table()["study"], "metrics": ["blurr"]}},
        r"did you mean blur\?\); taccel-lab study",
    ),
    ({"study": {**table()["study"], "presses": ["bal"]}}, r"no press 'bal' \(did you mean ball"),
    ({"study": {**table()["study"], "presses": ["ball"]}}, "'blur' is read from the press 'edge'"),
    ({"objective": {"minimize": "nonsense"}}, "no metric 'nonsense'"),
    ({"parameters": {"thicknes_mm": {"values": [3]}}}, r"did you mean thickness_mm\?"),
    ({"parameters": {"thickness_mm": {"values": [300]}}}, r"above its bound; allowed: [\d.]+ to"),
    ({"parameters": {"thickness_mm": {"min": 0.01, "max": 3, "count": 2}}}, "below its bound"),
    ({"parameters": {"thickness_mm": {"values": ["thin"]}}}, "is not a number"),
    ({"parameters": {"rim": {"values": ["round"]}}}, "use one of none, chamfer, fillet"),
    ({"parameters": {"rim": {"min": 1, "max": 2, "count": 2}}}, "give values"),
    ({"parameters": {"crown_radius_mm": {"min": 0, "max": 90, "count": 2}}}, "0 means flat"),
    ({"parameters": {"width_px": {"min": 320, "max": 322, "count": 5}}}, "gives 3 different"),
    ({"fixed": {"rim": "round"}}, r"\[fixed\] rim = 'round' is not allowed"),
    ({"fixed": {"hardness": "55 OO"}}, "a hardness is shore_00 = 55 or shore_a = 10"),
    ({"fixed": {"shore_00": 30}}, "young_modulus_mpa and shore_00 are given"),
    ({"fixed": {"nonsense": 1}}, r"no parameter of gelsight in \[fixed\] 'nonsense'"),
    ({"tied": {"rim": {"to": "thickness_mm"}}}, "only numbers can be tied"),
    ({"press": {"egde": {"depth_mm": 2}}}, r"did you mean edge\?"),
    ({"press": {"edge": {"depth": 2}}}, r"\[press.edge\] 'depth' \(did you mean depth_mm"),
    ({"press": {"edge": {"depth_mm": -2}}}, r"\[press.edge\] depth_mm must be above 0"),
    ({"press": {"edge": {"depth_mm": "2"}}}, r"\[press.edge\] depth_mm = '2'; something like"),
    (
        {"parameters": {n: {**WIDE, "count": 101} for n in ("width_px", "height_px")}},
        "101 x 101 = 10,201 designs",
    ),
]


@pytest.mark.parametrize(("changes", "message"), BAD)
def test_what_the_catalogue_does_not_have_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        study(**changes)


def test_grid_has_every_combination_once() -> None:
    points = study().points()
    assert [tuple(p.parameters.values()) for p in points] == [
        (t, e) for t in (3.0, 4.0, 5.0) for e in (0.1, 0.4)
    ]
    assert len({p.id for p in points}) == 6


def test_the_same_values_are_the_same_design() -> None:
    def ids(values: dict[str, Any], name: str = "young_modulus_mpa", **more: Any) -> list[str]:
        return [point.id for point in study(parameters={name: values}, **more).points()]

    logs = {"min": 0.1, "max": 0.4, "count": 3, "scale": "log"}
    assert ids({"values": [0.1, 0.2, 0.4]}) == ids(logs)
    # Defaults are part of a design.
    default, plain = study().parameters["thickness_mm"].default, {"values": ["none"]}
    assert ids(plain, "rim") == ids(plain, "rim", fixed={"thickness_mm": default})
    assert ids(plain, "rim") != ids(plain, "rim", fixed={"thickness_mm": default + 1})


def test_keys_follow_the_settings_of_the_presses_that_are_read() -> None:
    one, two = study(), study(press={"edge": {"depth_mm": 0.5}})
    assert one.points() == two.points()
    assert one.press_keys["ball"] == two.press_keys["ball"]
    assert one.press_keys["edge"] != two.press_keys["edge"]
    changed = {name for name in one.metrics if one.figure_keys[name] != two.figure_keys[name]}
    assert changed == {"blur"}
    heavy = study(study={**table()["study"], "metrics": ["blur", "lamps"], "load_n": 2.0})
    assert heavy.figure_keys["blur"] != one.figure_keys["blur"]
    light = study(study={**table()["study"], "metrics": ["blur", "lamps"]})
    assert heavy.figure_keys["lamps"] == light.figure_keys["lamps"]


def test_tied_parameters_follow() -> None:
    ties = {
        "height_px": {"to": "width_px", "factor": 0.75, "offset": 0.3},
        "mm_per_px": {"to": "width_px", "factor": 18.88, "power": -1},
    }
    first = study(parameters={"width_px": {"values": [320, 640]}}, tied=ties).points()[0]
    assert first.parameters == {"width_px": 320, "height_px": 240, "mm_per_px": 0.059}


def test_random_sweeps_repeat_and_fill_the_ranges() -> None:
    given = {
        "parameters": {
            "thickness_mm": {"min": 2, "max": 8}, "rim": {"values": ["none", "chamfer"]},
        },
        "sweep": {"kind": "random", "count": 20},
    }  # fmt: skip
    first = study(**given).points()
    assert first == study(**given).points()
    assert first != study(**given, study={**table()["study"], "seed": 1}).points()
    thickness = sorted(p.parameters["thickness_mm"] for p in first)
    assert all(2 + 0.3 * i <= t <= 2.3 + 0.3 * i for i, t in enumerate(thickness))
    assert [p.parameters["rim"] for p in first].count("none") == 10
    axes = [Axis(Parameter("x", 1.0, "mm", "", "", 0, 9), None, 1, 5)]
    few, many = (random_points(axes, count, 3, "sobol") for count in (5, 11))
    assert many[:5] == few, "more Sobol points keep the earlier ones"


NUMBER = Parameter("x", 1.0, "mm", "", "", 1e-3, 1e4)
WHOLE = Parameter("n", 1, "px", "", "", 1, 10_000)


@settings(max_examples=60, deadline=None)
@example(low=100.2265625, ratio=2.0, unit=1e-200, log=False)
@given(
    low=st.floats(1e-3, 5e3), ratio=st.floats(1.01, 2.0), unit=st.floats(0, 1), log=st.booleans()
)
def test_ranges_stay_in_their_bounds_and_map_back(low: float, ratio: float, unit: float, log: bool):
    wanted = ParameterRange(min=low, max=low * ratio, scale="log" if log else "linear")
    axis = axis_of(NUMBER, wanted)
    value = axis.at(unit)
    assert low <= value <= low * ratio
    assert axis.unit_of(value) == pytest.approx(unit, abs=1e-6 * low / (low * (ratio - 1)) + 1e-9)


@given(low=st.integers(1, 50), span=st.integers(1, 50), unit=st.floats(0, 1))
def test_whole_numbers_stay_whole(low: int, span: int, unit: float) -> None:
    axis = axis_of(WHOLE, ParameterRange(min=low, max=low + span))
    value = axis.at(unit)
    assert isinstance(value, int) and low <= value <= low + span
    assert axis.at(axis.unit_of(value)) == value


@pytest.mark.thorough
def test_designs_that_share_simulations_go_together() -> None:
    planned = study(
        parameters={
            "thickness_mm": {"values": [3.0, 4.0]},
            "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 40, "scale": "log"},
            "poisson_ratio": {"values": [0.4, 0.45]},
        }
    )
    wanted = [DesignBatch((p,), ("blur",), ("edge",)) for p in planned.points()]
    batches = gather_batches(planned.family, wanted, "cpu")
    assert sum(len(batch.designs) for batch in batches) == 160
    for batch in batches:
        names = ("thickness_mm", "poisson_ratio")
        shared = {tuple(d.parameters[name] for name in names) for d in batch.designs}
        assert len(batch.designs) <= MAX_BATCH and len(shared) == 1
    assert len(batches) == 4 * 2
    assert len(gather_batches(planned.family, wanted, "cuda:0")) == 1
