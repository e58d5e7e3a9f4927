# SPDX-License-Identifier: Apache-2.0
"""The report of a study: what it says, its rankings and sensitivities, its pictures."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from markupsafe import escape

from taccel_lab.cad.parameters import Parameter
from taccel_lab.studies.evaluate.design_row import (
    DesignRow,
    directed,
    is_feasible,
    least_violating,
    ranked,
    total_violation,
    violations,
)
from taccel_lab.studies.evaluate.runner import StudyOutcome, run_study
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.report.answer import Answer, answer
from taccel_lab.studies.report.sensitivity import Sensitivity, sensitivity
from taccel_lab.studies.report.values import pareto_front
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study_file import Constraint, Objective
from tests.support.fake_kit import METRICS, evaluate_and_tear, study, table

SQUARE = {
    "thickness_mm": {"min": 3, "max": 6, "count": 3},
    "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 3, "scale": "log"},
}


class Tags(HTMLParser):
    """Complains about tags that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in ("meta", "img", "br", "wbr", "link", "input", "hr"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page_of(root: Path) -> str:
    text = (root / "report.html").read_text(encoding="utf-8")
    Tags(text)
    assert set(re.findall(r'<a [^>]*href="#([^"]*)"', text)) <= set(re.findall(r'id="(.*?)"', text))
    pictures = re.findall(r"<img .*?>", text)
    assert len(re.findall(r"<a ", text)) == len(re.findall(r'<a [^>]*href="#', text))
    for picture in pictures:
        assert 'src="data:image/png;base64,' in picture and re.search(r'alt="[^"]', picture)
    # Its one script stands in the page.
    assert "<script src" not in text and "http" not in re.sub(r"data[:-][^\"]*", "", text)
    return text


def report(root: Path, **changes: Any) -> tuple[StudyOutcome, dict[str, Any]]:
    outcome = run_study(study(**changes), root, processes=0)
    return outcome, write_study_report(outcome)


def drawn(root: Path) -> set[str]:
    import cv2

    names = set()
    for path in (root / "figures").glob("*.png"):
        image = cv2.imread(str(path))
        assert image is not None and (image != 255).any(axis=2).mean() > 0.01, path
        names.add(path.stem)
    return names


@pytest.mark.thorough
@pytest.mark.rasterised
def test_a_grid_of_two_parameters_has_everything(tmp_path: Path) -> None:
    outcome, values = report(tmp_path, parameters=SQUARE)
    assert drawn(tmp_path) == {
        "pareto", "pairs", "parallel", "sensitivities", "effects", "maps", "curves", "gel",
    }  # fmt: skip
    text = page_of(tmp_path)
    assert text.count("<img ") == 8
    written = json.loads((tmp_path / "report.json").read_text())
    assert all(written[name] == values[name] for name in ("best", "counts", "pareto", "metrics"))
    assert values["verdict"]["good"] and values["verdict"]["headline"] == "9 designs compared"
    assert values["goal"] == "least stiffness"
    # E / t is least where E is least and t greatest.
    best, worst = (outcome.folder.read(values[key][0]) for key in ("best", "worst"))
    assert best and best.parameters == {"thickness_mm": 6.0, "young_modulus_mpa": 0.1}
    assert worst and worst.parameters == {"thickness_mm": 3.0, "young_modulus_mpa": 0.4}
    assert not set(values["best"]) & set(values["worst"])
    signs = np.array([1, -1, 1])
    cost = np.array([list(row.figures.values()) for row in outcome.rows], dtype=float) * signs
    beaten = [any((o <= c).all() and (o < c).any() for o in cost) for c in cost]
    expected = [r.id for r, lost in zip(outcome.rows, beaten, strict=True) if not lost]
    assert values["pareto"]["designs"] == expected
    effects = values["sensitivities"]["range"]["effects"]
    assert effects["thickness_mm"]["elasticity"] == pytest.approx(1)
    assert values["cost"]["simulations"] == 18
    # The best design's gel can be turned: 6 mm thick.
    assert text.count('class="mesh-view"') == 1
    assert re.search(r"untouched gel of [^\"]*thickness 6 mm[^\"]* \(best 1\)", text)
    assert re.search(r"[\d.]+ x [\d.]+ x 6 mm", text)
    for name in ("thickness 6 mm", "thickness 3 mm", "N/mm", "young_modulus_mpa", "designs.csv"):
        assert name in text
    # Designs are called by their values; a hash stands once, in the last column of the table of
    # all designs: the design's folder.
    name = values["names"][values["best"][0]]
    assert name == "thickness 6 mm, Young's modulus 0.1 MPa"
    assert f"has {name}." in values["verdict"]["sentences"][0]
    assert f"The untouched gel of {escape(name)} (best 1)" in text
    for row in outcome.rows:
        assert text.count(row.id) == 1 and f"{row.id}</td></tr>" in text


@pytest.mark.thorough
def test_failures_and_gaps_are_told_with_causes(tmp_path: Path) -> None:
    rims = {
        "rim": {"values": ["none", "chamfer", "fillet"]},
        "thickness_mm": {"values": [4, 5, 6]},
    }
    _, values = report(tmp_path, parameters=rims)
    assert values["counts"]["failed"] == 3
    assert {item["cause"] for item in values["failures"]} == {"the fillet does not fit"}
    assert values["gaps"][0]["what"] == "blur" and len(values["gaps"][0]["designs"]) == 3
    text = page_of(tmp_path)
    assert "the fillet does not fit" in text and "no edge was found" in text


@pytest.mark.thorough
def test_means_over_holes_of_a_grid_are_not_taken(tmp_path: Path) -> None:
    outcome = run_study(study(evaluate_and_tear, parameters=SQUARE), tmp_path, processes=0)
    values = write_study_report(outcome)
    found = values["sensitivities"]["range"]
    assert (found["count"], found["lacking"]) == (8, 1)
    thickness, modulus = (found["effects"][name] for name in SQUARE)
    # Range 10 E t: of both parameters the six designs whose partners all stand.
    assert thickness["compared"] == modulus["compared"] == 6
    assert [thickness["means"][t] for t in (3.0, 4.5, 6.0)] == pytest.approx([4.5, 6.75, 9])
    assert [modulus["means"][e] for e in (0.1, 0.2, 0.4)] == pytest.approx([5.25, 10.5, 21])
    assert thickness["share"] == pytest.approx(modulus_free_share(outcome))
    text = page_of(tmp_path)
    assert "2 of 9 designs have no blur." in text and "compare only designs that" in text
    assert "6 can be compared" in text and "8 of 9" in text
    assert {"effects", "maps"} <= drawn(tmp_path)


def modulus_free_share(outcome: StudyOutcome) -> float:
    """Share of the thickness in the variance of the range, of the designs at 0.1 and 0.2 MPa."""
    kept = [row for row in outcome.rows if row.parameters["young_modulus_mpa"] < 0.4]
    y = np.array([row.figures["range"] for row in kept], dtype=float).reshape(3, 2)
    return float(y.mean(axis=1).var() / y.var())


@pytest.mark.thorough
def test_constraints_that_no_design_keeps_name_the_nearest(tmp_path: Path) -> None:
    _, values = report(
        tmp_path, parameters=SQUARE, constraints=[{"metric": "stiffness", "max": 0.1}]
    )
    assert not values["verdict"]["good"]
    assert values["best"] == values["worst"] == []
    nearest = values["nearest"]
    # E / t of the softest and thickest: 10 x 0.1 / 6.
    assert nearest["violations"]["stiffness"] == pytest.approx(1 / 6 - 0.1)
    text = page_of(tmp_path)
    assert "No design keeps the constraints" in text
    assert escape(values["names"][nearest["design"]]) in text


@pytest.mark.thorough(cases=("5-5 of 9 designs are done",))
@pytest.mark.parametrize(
    ("limit", "headline"), [(5, "5 of 9 designs are done"), (None, "No design has figures")]
)
def test_a_study_without_an_answer_says_so(
    tmp_path: Path, limit: int | None, headline: str
) -> None:
    parameters = SQUARE if limit else {"rim": {"values": ["fillet"]}}
    outcome = run_study(study(parameters=parameters), tmp_path, processes=0, limit=limit)
    verdict = write_study_report(outcome)["verdict"]
    assert verdict["headline"] == headline and not verdict["good"]
    page_of(tmp_path)


@pytest.mark.thorough
def test_random_sweeps_and_single_designs_have_reports(tmp_path: Path) -> None:
    ranges = {"thickness_mm": {"min": 3, "max": 6}, "width_px": {"min": 300, "max": 700}}
    _, values = report(tmp_path / "random", parameters=ranges, sweep={"kind": "random", "count": 6})
    effects = values["sensitivities"]["stiffness"]["effects"]
    assert effects["thickness_mm"]["rank"] == pytest.approx(-1)
    assert abs(effects["width_px"]["elasticity"]) < 1e-6
    assert "maps" not in drawn(tmp_path / "random")
    _, values = report(tmp_path / "one", parameters={"thickness_mm": {"values": [4]}})
    assert drawn(tmp_path / "one") == {"gel"} and values["verdict"]["good"]
    for name in ("random", "one"):
        page_of(tmp_path / name)


@pytest.mark.thorough
def test_texts_of_the_study_are_escaped_and_figures_of_an_earlier_report_go(tmp_path: Path) -> None:
    report(tmp_path, parameters=SQUARE)
    named = {**table()["study"], "name": "<b>bold</b> & more"}
    report(tmp_path, study=named, parameters={"thickness_mm": {"values": [4]}})
    text = page_of(tmp_path)
    assert "&lt;b&gt;bold&lt;/b&gt; &amp; more" in text and "<b>bold" not in text
    assert drawn(tmp_path) == {"gel"}


# Rankings -----------------------------------------------------------------------------------------


def design(name: str, status: str = "done", **figures: float | None) -> DesignRow:
    return DesignRow(name, "gelsight", {}, status, figures)  # type: ignore[arg-type]


BOUNDS = [Constraint(metric="a", min=10), Constraint(metric="b", max=1)]


def test_bounds_are_kept_to_a_thousandth_of_them() -> None:
    small = [Constraint(metric="a", max=2e-4)]
    for row, bounds, kept in (
        (design("x", a=10, b=1), BOUNDS, True),
        (design("x", a=9.991, b=1.0009), BOUNDS, True),
        (design("x", a=9.98, b=1), BOUNDS, False),
        (design("x", a=None, b=1), BOUNDS, False),
        (design("x", "failed", a=20, b=0), BOUNDS, False),
        (design("x", a=2.001e-4), small, True),
        (design("x", a=3e-4), small, False),
    ):
        assert is_feasible(row, bounds) == kept
    assert violations(design("x", a=8, b=None), BOUNDS) == {"a": 2, "b": None}
    near, far, blank = design("n", a=8, b=1), design("f", a=10, b=1.5), design("b", a=None, b=0)
    assert total_violation(near, BOUNDS) == 0.2 and total_violation(far, BOUNDS) == 0.5
    assert least_violating([far, blank, near], BOUNDS) is near
    assert least_violating([blank], BOUNDS) is None


def test_ranking_follows_the_goal() -> None:
    designs = [design("x", a=12, b=0.5), design("y", a=30, b=0.9), design("z", a=40, b=3)]
    assert [d.id for d in ranked(designs, Objective(maximize="a"), BOUNDS)] == ["y", "x"]
    assert [d.id for d in ranked(designs, Objective(minimize="b"), [])] == ["x", "y", "z"]
    assert [d.id for d in ranked([design("n", a=None)], Objective(minimize="a"), [])] == []


def test_without_an_objective_the_first_metric_with_a_better_side_counts() -> None:
    stiffness, reach = Objective(minimize="stiffness"), Objective(maximize="range")
    assert directed([], METRICS) == [stiffness, reach, Objective(minimize="blur")]
    assert directed([], {"lamps": METRICS["lamps"]}) == []
    blur = Objective(maximize="blur")
    assert directed([blur], METRICS) == [blur, stiffness, reach]


def test_front_of_known_points() -> None:
    costs = np.array([[1, 5], [2, 3], [3, 3], [4, 1], [2, 3], [5, 5], [np.nan, 0]])
    assert pareto_front(costs).tolist() == [True, True, False, True, True, False, False]


@given(
    arrays(np.float64, st.tuples(st.integers(1, 12), st.integers(1, 3)), elements=st.integers(0, 4))
)
def test_front_is_beaten_by_nobody_and_beats_the_rest(costs: np.ndarray) -> None:
    front = pareto_front(costs)

    def beats(one: np.ndarray, other: np.ndarray) -> bool:
        return bool((one <= other).all() and (one < other).any())

    assert front.any()
    for row, on_front in zip(costs, front, strict=True):
        assert on_front != any(beats(other, row) for other in costs[front])


# Sensitivities of formulas whose answer is known --------------------------------------------------


def of_grid(columns: list[list[float]], figure: Callable[..., float | None]) -> Sensitivity:
    """Of a figure over the grid of t and e."""
    points = list(itertools.product(*columns))
    t, e = (list(column) for column in zip(*points, strict=True))
    return sensitivity({"t": t, "e": e}, [figure(*point) for point in points], grid=True)


def test_powers_are_elasticities() -> None:
    found = of_grid([[1, 2, 4], [0.1, 0.3, 0.9]], lambda t, e: 7 * t**-1.5 * e**0.5)
    assert found.effects["t"].elasticity == pytest.approx(-1.5)
    assert found.effects["e"].elasticity == pytest.approx(0.5)
    assert found.r2 == pytest.approx(1) and found.count == 9


def test_shares_of_a_sum_add_up() -> None:
    found = of_grid([[1, 2, 3], [10, 30]], lambda t, e: t + e).effects
    # Variances of the levels: 2/3 and 100.
    assert found["t"].share == pytest.approx((2 / 3) / (100 + 2 / 3))
    assert found["e"].share == pytest.approx(100 / (100 + 2 / 3))
    assert found["e"].means == {10: 12, 30: 32} and found["e"].rank is None


def test_ranks_see_any_rise() -> None:
    x = np.linspace(1, 9, 30)
    z = np.resize([1.0, 2.0, 3.0], 30)
    found = sensitivity({"x": list(x), "z": list(z)}, list(-np.exp(x)), grid=False)
    assert found.effects["x"].rank == pytest.approx(-1)
    assert abs(found.effects["z"].rank or 0) < 0.3
    assert found.effects["x"].elasticity is None, "a negative metric has no logarithm"
    assert found.effects["x"].share is None


def test_choices_have_a_share_only() -> None:
    found = sensitivity({"rim": ["a", "a", "b", "b"]}, [1.0, 1.0, 3.0, 3.0], grid=True)
    assert found.effects["rim"].share == pytest.approx(1)
    assert found.effects["rim"].elasticity is None


def test_missing_and_constant_figures() -> None:
    found = sensitivity({"x": [1.0, 2.0, 3.0]}, [1.0, None, 3.0], grid=False)
    assert found.count == 2
    same = sensitivity({"x": [1.0, 2.0, 3.0, 4.0]}, [5.0] * 4, grid=True).effects["x"]
    assert same.share is None and same.elasticity is None and same.rank is None
    flat = sensitivity({"x": [0.0, 2.0, 3.0, 4.0]}, [5.0, 6.0, 7.0, 8.0], grid=False).effects["x"]
    assert flat.elasticity is None and flat.rank == pytest.approx(1)


def test_holes_of_a_grid_do_not_bend_the_means() -> None:
    """Thin hard gels break: plain means of 30, 60 and 160 would make four times the hardness more
    than five times it."""
    holes = {(1, 40), (1, 20)}
    found = of_grid(
        [[1, 2, 4], [10, 20, 40]], lambda t, e: None if (t, e) in holes else float(t * e)
    )
    assert (found.count, found.lacking) == (7, 2)
    # At 10 every thickness has a figure; at 2 and 4 every hardness.
    assert found.effects["t"].means == {1: 10, 2: 20, 4: 40}
    assert found.effects["e"].means == {10: 30, 20: 60, 40: 120}
    assert (found.effects["t"].compared, found.effects["e"].compared) == (3, 6)


def test_levels_without_designs_or_partners() -> None:
    columns = [[1, 2, 4], [10, 20]]
    gap = of_grid(columns, lambda t, e: None if t == 1 else float(t * e)).effects["t"]
    assert gap.means == {1: None, 2: 30, 4: 60} and gap.compared == 4
    alone = of_grid([[1, 2], [10, 20]], lambda t, e: {11: 1.0, 22: 4.0}.get(t + e)).effects["t"]
    assert alone.compared == 0 and alone.share is None and alone.means == {1: None, 2: None}


# Answers ------------------------------------------------------------------------------------------


STIFFNESS = Objective(minimize="stiffness")
THICKNESS = Axis(Parameter("thickness_mm", 3.0, "mm", "thickness", "a test"), None, 2.0, 5.0)


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
    return answer(best, rows, goal, constraints, [THICKNESS], found)


def test_a_constraint_that_every_better_design_breaks_limits_it() -> None:
    found = answered([Constraint(metric="range", max=33.0)])
    assert found.design == "4"
    assert [limit.name for limit in found.limits] == ["range"]
    assert found.limits[0].text == "range at most 33"
    # 4.05 and 4.0 mm differ by 1.2 %, which no press tells apart; 2 t^2 is 33 at 4.062 mm.
    assert found.intervals["thickness_mm"] == pytest.approx((4.0, 16.5**0.5))


def test_gels_that_may_be_softer_or_stiffer_widen_the_range_inside_what_was_swept() -> None:
    at_most = [Constraint(metric="range", max=33.0)]
    low, high = answered(at_most, ends=(0.8, 1.25)).intervals["thickness_mm"]
    # The range is 2 t^2: the elasticity is 2.
    best = 2 * 4.05**2
    assert low == pytest.approx(4.05 * (33.0 / (1.25 * best)) ** 0.5)
    assert high == pytest.approx(4.05 * (33.0 / (0.8 * best)) ** 0.5)
    assert answered(at_most, ends=(0.1, 10.0)).intervals["thickness_mm"] == (2.0, 5.0)


def test_the_end_of_a_range_limits_it_where_no_constraint_does() -> None:
    assert [limit.text for limit in answered([]).limits] == ["thickness_mm, whose range ends at 5"]
    stiffest = answered([], goal=Objective(maximize="stiffness"))
    assert "ends at 2" in stiffest.limits[0].text
    assert answered([], thicknesses=(2.0, 3.0, 4.0)).limits == (), "an optimum inside has no limit"
