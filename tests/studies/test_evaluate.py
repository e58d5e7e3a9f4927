# SPDX-License-Identifier: Apache-2.0
"""Figures of designs: shared simulations, isolated failures, several indenters and loads."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv
from taccel_lab.solvers import EnvStatus, StepReport
from taccel_lab.studies.evaluate import evaluate
from taccel_lab.studies.evaluate.evaluate import Unknowns, evaluate_designs
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.metrics import METRICS
from taccel_lab.studies.metrics.design_point import DesignPoint
from taccel_lab.studies.presses import press_batch
from taccel_lab.studies.presses.standard import STANDARD_PRESSES
from taccel_lab.studies.spec.readings import described, split_name
from taccel_lab.studies.spec.study import Study, make_study, read_study
from taccel_lab.studies.spec.study_file import spec_of
from tests.studies.coarse_presses import COARSE, coarse

SPHERE = coarse("sphere", steps=3)
SIMPLE = [
    replace(METRICS[name], load_n=0.3)
    for name in ("stiffness_secant", "bond_stress", "sensitivity_um")
]


def gelsight(name: str, **parameters: object) -> DesignPoint:
    return DesignPoint(name, "gelsight", dict(parameters))


@pytest.mark.thorough
def test_designs_share_what_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluate, "_recent", {})
    told: list[tuple[str, int, int]] = []
    results = evaluate_designs(
        [
            gelsight("a"),
            gelsight("b", young_modulus_mpa=0.3),
            gelsight("c", thickness_mm=4.8),
            gelsight("d", density_kg_m3=1200, young_modulus_mpa=0.3),
        ],
        [SPHERE],
        SIMPLE,
        progress=lambda *values: told.append(values),
        folder=tmp_path,
    )
    a, b, c, d = results
    assert [result.simulations for result in results] == [1, 0, 1, 0]
    assert all(result.causes == {} for result in results)
    assert told == [("meshed", 0, 2), ("press sphere", 2, 2)]
    force_a, force_b = (np.array(r.curves["sphere"][0]["force_n"]) for r in (a, b))
    assert force_b == pytest.approx(2 * force_a)
    assert d.figures == b.figures
    # At the same load the stiffer gel moves less, and the thinner one too at the same depth.
    assert b.figures["sensitivity_um"] < a.figures["sensitivity_um"]  # type: ignore[operator]
    assert c.figures["stiffness_secant"] != a.figures["stiffness_secant"]
    assert all(result.seconds > 0 for result in results)
    kept = np.load(tmp_path / "b" / "press_sphere.npz")
    assert kept["force_n"] == pytest.approx(force_b)
    assert kept["contact_moved_m"].shape == (3, len(kept["contact_rest_m"]), 3)
    assert kept["contact_faces"].max() < len(kept["contact_rest_m"])
    curves = json.loads((tmp_path / "b" / "presses.json").read_text())
    assert curves == to_jsonable(b.curves)
    # Nor is a gel that was pressed before simulated anew for another modulus.
    (later,) = evaluate_designs([gelsight("e", young_modulus_mpa=0.3)], [SPHERE], SIMPLE)
    assert later.simulations == 0 and later.figures == b.figures


@pytest.mark.thorough
def test_what_cannot_be_built_or_set_up_leaves_the_others_alone() -> None:
    away = coarse("sphere", name="away", steps=2, places=((1.0, 1.0),))
    narrow, bad, unknown = evaluate_designs(
        [
            gelsight("narrow", length_x_mm=12, length_y_mm=12),
            gelsight("bad", thickness_mm=0.5),
            DesignPoint("x", "gelsite", {}),
        ],
        [away, SPHERE],
        SIMPLE,
    )
    assert None not in narrow.figures.values()
    assert list(narrow.causes) == ["press away"] and list(narrow.curves) == ["sphere"]
    for lost, words in ((bad, "thickness_mm = 0.5 is below its bound"), (unknown, "gelsite")):
        assert set(lost.figures.values()) == {None} and set(lost.figures) == set(narrow.figures)
        assert words in lost.causes["design"] and lost.simulations == 0
        assert lost.causes["stiffness_secant"] == lost.causes["design"]


@pytest.mark.thorough
def test_a_press_that_does_not_converge_leaves_its_batch_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second environment of a batch is made to fail in the second of three steps."""
    stays: list[list[bool]] = []

    class Failing(PressEnv):
        def try_to(self, *args: Any, stay: np.ndarray, **more: Any) -> StepReport:
            stays.append(stay.tolist())
            report = super().try_to(*args, stay=stay, **more)
            if len(stays) == 2:
                report.status[1] = EnvStatus.LINE_SEARCH
            return report

    monkeypatch.setattr(press_batch, "PressEnv", Failing)
    monkeypatch.setattr(evaluate, "_recent", {})
    designs = [gelsight("easy"), gelsight("hard", thickness_mm=6)]
    easy, hard = evaluate_designs(designs, [SPHERE], [METRICS["bond_stress"]])
    assert stays == [[False, False], [False, False], [False, True]]
    assert easy.causes == {} and easy.figures["bond_stress"] is not None
    assert hard.figures["bond_stress"] is None
    depths = [len(design.curves["sphere"][0]["depth_mm"]) for design in (easy, hard)]
    assert depths == [3, 1]
    cause = hard.causes["press sphere"]
    assert cause.startswith("step 2 of 3: the press at (0, 0) mm") and "LINE_SEARCH" in cause
    assert hard.causes["bond_stress"] == f"press sphere: {cause}"


@pytest.mark.parametrize(
    ("names", "presses", "message"),
    [("aa", [SPHERE], "unique ids"), ("a", [SPHERE, SPHERE], "unique names")],
)
def test_ids_and_names_must_differ(names: str, presses: list, message: str) -> None:
    with pytest.raises(InputError, match=message):
        evaluate_designs([gelsight(name) for name in names], presses, SIMPLE)


@pytest.mark.slow
def test_a_whole_design() -> None:
    (result,) = evaluate_designs(
        [gelsight("a")], list(STANDARD_PRESSES.values()), list(METRICS.values())
    )
    figures = {name: value for name, value in result.figures.items() if value is not None}
    # The camera's aperture is not published.
    assert set(result.figures) - set(figures) == {"depth_of_field"}
    assert result.simulations == 15
    assert 0.4 < figures["stiffness_secant"] < 0.8
    assert figures["uniformity_force"] < 5 and figures["hysteresis_press"] < 2
    assert 0.1 < figures["grating_modulation"] < 0.6
    assert figures["two_point_resolution"] < 1.0


# Several indenters and loads ----------------------------------------------------------------------


def wanted(
    metrics: list[str], press: dict[str, Any] | None = None, objective: str = "", **block: Any
) -> Study:
    table: dict[str, Any] = {
        "study": {"name": "x", "sensor": "flat_pad", "metrics": metrics, **block},
        "parameters": {"thickness_mm": {"values": [1.0, 2.0]}},
        "sweep": {"kind": "grid"},
        "press": press or {},
    }
    if objective:
        table["objective"] = {"maximize": objective}
    return make_study(spec_of(table), default_kit())


TWO = {"sphere": {"indenters": ["sphere:2", "sphere:4"]}}


def test_one_indenter_and_one_load_keep_the_plain_name_and_say_the_true_size() -> None:
    study = wanted(["stiffness_secant"], {"sphere": {"indenters": ["sphere:2"]}}, load_n=0.2)
    (metric,) = study.metrics.values()
    assert metric.name == "stiffness_secant"
    assert metric.description == "load over depth of a ball of 2 mm radius at 0.2 N"
    for metric in default_kit().metrics.values():
        text = described(metric).description
        assert "{" not in text and "3 mm radius" not in text


def test_every_indenter_at_every_load_is_a_metric_and_labels_pick_some() -> None:
    study = wanted(["depth_at_load", "force_range", "px_per_mm"], TWO, loads_n=[0.2, 1])
    assert list(study.metrics) == [
        "depth_at_load[sphere:2, 0.2 N]", "depth_at_load[sphere:2, 1 N]",
        "depth_at_load[sphere:4, 0.2 N]", "depth_at_load[sphere:4, 1 N]",
        "force_range[sphere:2]", "force_range[sphere:4]", "px_per_mm",
    ]  # fmt: skip
    assert "4 mm radius" in study.metrics["force_range[sphere:4]"].description
    assert len(set(study.figure_keys.values())) == 7
    study = wanted(["depth_at_load[ 1 N ]", "bond_stress[sphere:4,0.2 N]"], TWO, loads_n=[0.2, 1])
    assert list(study.metrics) == [
        "depth_at_load[sphere:2, 1 N]", "depth_at_load[sphere:4, 1 N]",
        "bond_stress[sphere:4, 0.2 N]",
    ]  # fmt: skip
    assert split_name("a[sphere:2,  1 N]") == ("a", ("sphere:2", "1 N"))


def test_curves_are_read_from_punches_as_well() -> None:
    study = wanted(["depth_at_load"], {**TWO, "punch": {}})
    assert list(study.presses) == ["sphere", "punch"]
    assert study.metrics["depth_at_load[cylinder:2]"].presses == ("punch",)
    (alone,) = wanted(["depth_at_load[cylinder:2]"]).metrics.values()
    assert alone.presses == ("punch",) and "flat punch of 2 mm radius" in alone.description


DEPTH = ["depth_at_load"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metrics": ["depth_at_load[sphere:9]"]}, "'sphere:9'.*known: sphere:2, sphere:4"),
        ({"metrics": ["depth_at_load[2 kg]"]}, "'2 kg'"),
        ({"metrics": ["px_per_mm[1 N]"]}, "read from no press; leave out 1 N"),
        ({"metrics": ["depth_at_load["]}, "study.metrics"),
        ({"metrics": DEPTH, "load_n": 1, "loads_n": [1, 2]}, "either load_n or"),
        ({"metrics": DEPTH, "loads_n": [1, -2]}, "loads_n"),
        ({"metrics": DEPTH, "loads_n": [1, 1]}, "named twice"),
        ({"metrics": DEPTH, "accuracy": "best"}, "accuracy"),
        ({"metrics": DEPTH, "load_n": 500}, "depth_at_load.*no gel of this study bears 500 N.*abo"),
        ({"metrics": DEPTH, "loads_n": [1, 500]}, "no gel of this study bears 500 N"),
        ({"metrics": ["force_range"], "objective": "force_range"}, r"\[objective\].*name one"),
    ],
)
def test_what_a_study_does_not_have_is_refused(changes: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        wanted(press=TWO, **changes)


def test_loads_and_objectives_that_it_has() -> None:
    for load in (0.2, 2.0):
        wanted(DEPTH, TWO, load_n=load)
    (goal,) = wanted(["force_range"], TWO, "force_range[sphere:4]").spec.goals
    assert goal.metric == "force_range[sphere:4]"


def test_accuracy_and_depth_are_those_of_presses(tmp_path: Path) -> None:
    press = wanted(["force_range"], {"sphere": {"depth_mm": 3.5}}, accuracy="reference").presses
    assert press["sphere"].physics == PHYSICS[Accuracy.REFERENCE]
    assert press["sphere"].full_depth_mm(9.0) == 3.5
    file = tmp_path / "a.toml"
    file.write_text(
        'study = {name = "x", sensor = "flat_pad", metrics = ["force_range"]}\n'
        'parameters.thickness_mm.values = [1.0, 2.0]\nsweep.kind = "grid"\n'
    )
    fast = read_study(file, default_kit(), "fast")
    assert fast.presses["sphere"].physics == PHYSICS[Accuracy.FAST]
    assert fast.press_keys != read_study(file, default_kit()).press_keys


@pytest.mark.thorough
def test_figures_of_two_balls_differ_and_lie_in_their_intervals() -> None:
    names = ["depth_at_load", "contact_diameter", "stiffness_a"]
    study = wanted(names, TWO, load_n=0.1)
    press = coarse("sphere", indenters=("sphere:2", "sphere:4"), steps=4, mesh=COARSE)
    (point, _) = study.points()
    (result,) = evaluate_designs(
        [point], [press], list(study.metrics.values()), unit_spread=0.13
    )  # fmt: skip
    assert result.causes == {}
    for name in names:
        small, large = (result.figures[f"{name}[sphere:{r}]"] for r in (2, 4))
        assert small is not None and large is not None
        assert small > large if name == "depth_at_load" else small < large
        for radius, value in ((2, small), (4, large)):
            low, high = result.intervals[f"{name}[sphere:{radius}]"]
            assert low is not None and high is not None and low < value < high
    low, high = result.intervals["stiffness_a[sphere:4]"]
    # Units alone make a quarter; an incompressible gel of 1 mm is stiffer by another quarter.
    assert high / result.figures["stiffness_a[sphere:4]"] > 1.3  # type: ignore[operator]


@pytest.mark.thorough
def test_the_low_end_of_a_gel_whose_friction_is_not_given_is_that_without_friction() -> None:
    study = wanted(["force_range"], {"sphere": {"indenters": ["sphere:2"]}})
    thin, _ = study.points()
    press = coarse("sphere", indenters=("sphere:2",), depth_fraction=0.375, steps=2, mesh=COARSE)
    (result,) = evaluate_designs([thin], [press], list(study.metrics.values()))
    (record,) = result.records["sphere"]
    parameters = study.family.parameters(thin.parameters)
    given = {**thin.parameters, "poisson_ratio": 0.499}
    assert Unknowns(parameters, {**given, "friction": 1.0}, 0.0).force_factors(record) == (1.0, 1.0)
    low, high = Unknowns(parameters, given, 0.0).force_factors(record)
    # By presses of an incompressible gel of 1 mm at friction 1 and without, 0.375 mm deep.
    assert math.log(1 / low) == pytest.approx(0.273, rel=0.1) and high == 1.0


def test_a_depth_beyond_the_gel_is_a_cause_and_no_crash() -> None:
    study = wanted(["depth_at_load"], {"sphere": {"depth_mm": 1.5}})
    thin, _ = study.points()
    (result,) = evaluate_designs(
        [thin], list(study.presses.values()), list(study.metrics.values())
    )  # fmt: skip
    assert "1.5 mm is too deep for a gel of 1 mm; at most 0.8 mm" in str(result.causes)
