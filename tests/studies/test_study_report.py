# SPDX-License-Identifier: Apache-2.0
"""The report of a study: what it says, its rankings and sensitivities, its pictures."""

from __future__ import annotations

import itertools
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from markupsafe import escape

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
from taccel_lab.studies.report.sensitivity import sensitivity
from taccel_lab.studies.report.values import pareto_front
from taccel_lab.studies.spec.study_file import Constraint, Objective
from tests.support.fake_kit import METRICS, evaluate_and_tear, study, table

SQUARE = {
    "thickness_mm": {"min": 3, "max": 6, "count": 3},
    "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 3, "scale": "log"},
}


class Page(HTMLParser):
    """Ids, links and pictures of a page; complains about tags that are not closed in order."""

    VOID = ("meta", "img", "br", "wbr", "link", "input", "hr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.pictures: list[dict[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if values.get("id"):
            self.ids.add(str(values["id"]))
        if tag == "a":
            self.links.append(str(values["href"]))
        if tag == "img":
            self.pictures.append(values)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def page_of(root: Path) -> tuple[Page, str]:
    text = (root / "report.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert not page.open
    assert all(link[1:] in page.ids for link in page.links)
    for picture in page.pictures:
        assert str(picture["src"]).startswith("data:image/png;base64,") and picture["alt"]
    # Its one script stands in the page.
    assert "<script src" not in text and "http" not in re.sub(r"data[:-][^\"]*", "", text)
    return page, text


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
    page, text = page_of(tmp_path)
    assert len(page.pictures) == 8
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
    _, text = page_of(tmp_path)
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
    _, text = page_of(tmp_path)
    assert "2 of 9 designs have no blur." in text and "compare only designs that" in text
    assert "6 can be compared" in text and "8 of 9" in text
    assert {"effects", "maps"} <= drawn(tmp_path)


def modulus_free_share(outcome: StudyOutcome) -> float:
    """Share of the thickness in the variance of the range, of the designs at 0.1 and 0.2 MPa."""
    kept = [row for row in outcome.rows if row.parameters["young_modulus_mpa"] < 0.4]
    y = np.array([row.figures["range"] for row in kept], dtype=float).reshape(3, 2)
    return float(y.mean(axis=1).var() / y.var())


@pytest.mark.thorough
def test_designs_are_called_by_their_values(tmp_path: Path) -> None:
    outcome, values = report(tmp_path, parameters=SQUARE)
    best = values["names"][values["best"][0]]
    assert best == "thickness 6 mm, Young's modulus 0.1 MPa"
    assert f"has {best}." in values["verdict"]["sentences"][0]
    _, text = page_of(tmp_path)
    assert f"The untouched gel of {escape(best)} (best 1)" in text
    # A hash stands once, in the last column of the table of all designs: the design's folder.
    for row in outcome.rows:
        assert text.count(row.id) == 1 and f"{row.id}</td></tr>" in text


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
    _, text = page_of(tmp_path)
    assert "No design keeps the constraints" in text
    assert escape(values["names"][nearest["design"]]) in text


@pytest.mark.thorough
def test_an_unfinished_study_says_so(tmp_path: Path) -> None:
    outcome = run_study(study(parameters=SQUARE), tmp_path, processes=0, limit=5)
    verdict = write_study_report(outcome)["verdict"]
    assert verdict["headline"] == "5 of 9 designs are done" and not verdict["good"]
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


def test_no_figures_at_all(tmp_path: Path) -> None:
    _, values = report(tmp_path, parameters={"rim": {"values": ["fillet"]}})
    assert values["verdict"]["headline"] == "No design has figures"
    page_of(tmp_path)


@pytest.mark.thorough
def test_texts_of_the_study_are_escaped(tmp_path: Path) -> None:
    named = {**table()["study"], "name": "<b>bold</b> & more"}
    report(tmp_path, study=named, parameters={"thickness_mm": {"values": [4, 5]}})
    _, text = page_of(tmp_path)
    assert "&lt;b&gt;bold&lt;/b&gt; &amp; more" in text and "<b>bold" not in text


@pytest.mark.thorough
def test_figures_of_an_earlier_report_go(tmp_path: Path) -> None:
    report(tmp_path, parameters=SQUARE)
    report(tmp_path, parameters={"thickness_mm": {"values": [4]}})
    assert drawn(tmp_path) == {"gel"}


# Rankings -----------------------------------------------------------------------------------------


def design(name: str, status: str = "done", **figures: float | None) -> DesignRow:
    return DesignRow(name, "gelsight", {}, status, figures)  # type: ignore[arg-type]


BOUNDS = [Constraint(metric="a", min=10), Constraint(metric="b", max=1)]


def test_bounds_are_kept_to_a_thousandth() -> None:
    assert is_feasible(design("x", a=10, b=1), BOUNDS)
    assert is_feasible(design("x", a=9.991, b=1.0009), BOUNDS)
    assert not is_feasible(design("x", a=9.98, b=1), BOUNDS)
    assert not is_feasible(design("x", a=None, b=1), BOUNDS)
    assert not is_feasible(design("x", "failed", a=20, b=0), BOUNDS)
    assert violations(design("x", a=8, b=None), BOUNDS) == {"a": 2, "b": None}
    small = [Constraint(metric="a", max=2e-4)]
    assert is_feasible(design("x", a=2.001e-4), small)
    assert not is_feasible(design("x", a=3e-4), small), "of a small bound, too"


def test_the_nearest_design_is_measured_in_parts_of_the_bounds() -> None:
    near, far = design("near", a=8, b=1), design("far", a=10, b=1.5)
    assert total_violation(near, BOUNDS) == 0.2 and total_violation(far, BOUNDS) == 0.5
    assert least_violating([far, design("blank", a=None, b=0), near], BOUNDS) is near
    assert least_violating([design("blank", a=None, b=0)], BOUNDS) is None


def test_ranking_follows_the_goal() -> None:
    designs = [design("x", a=12, b=0.5), design("y", a=30, b=0.9), design("z", a=40, b=3)]
    assert [d.id for d in ranked(designs, Objective(maximize="a"), BOUNDS)] == ["y", "x"]
    assert [d.id for d in ranked(designs, Objective(minimize="b"), [])] == ["x", "y", "z"]
    assert [d.id for d in ranked([design("n", a=None)], Objective(minimize="a"), [])] == []


def test_without_an_objective_the_first_metric_with_a_better_side_counts() -> None:
    assert directed([], METRICS) == [
        Objective(minimize="stiffness"),
        Objective(maximize="range"),
        Objective(minimize="blur"),
    ]
    assert directed([], {"lamps": METRICS["lamps"]}) == []
    found = directed([Objective(maximize="blur")], METRICS)
    assert found == [
        Objective(maximize="blur"),
        Objective(minimize="stiffness"),
        Objective(maximize="range"),
    ]


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


def grid(*columns: list[float]) -> list[tuple[float, ...]]:
    return list(itertools.product(*columns))


def test_powers_are_elasticities() -> None:
    points = grid([1, 2, 4], [0.1, 0.3, 0.9])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [7 * a**-1.5 * b**0.5 for a, b in points], grid=True)
    assert found.effects["t"].elasticity == pytest.approx(-1.5)
    assert found.effects["e"].elasticity == pytest.approx(0.5)
    assert found.r2 == pytest.approx(1) and found.count == 9


def test_shares_of_a_sum_add_up() -> None:
    points = grid([1, 2, 3], [10, 30])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [a + b for a, b in points], grid=True)
    # Variances of the levels: 2/3 and 100.
    assert found.effects["t"].share == pytest.approx((2 / 3) / (100 + 2 / 3))
    assert found.effects["e"].share == pytest.approx(100 / (100 + 2 / 3))
    assert found.effects["e"].means == {10: 12, 30: 32}
    assert found.effects["e"].rank is None


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
    """Thin hard gels break: plain means would make hardness look weaker at every thickness."""
    points = grid([1, 2, 4], [10, 20, 40])
    t, e = (list(column) for column in zip(*points, strict=True))
    truth = {point: point[0] * point[1] for point in points}
    values = [None if p in ((1, 40), (1, 20)) else float(truth[p]) for p in points]
    found = sensitivity({"t": t, "e": e}, values, grid=True)
    assert (found.count, found.lacking) == (7, 2)
    # At 10 every thickness has a figure; at 2 and 4 every hardness.
    assert found.effects["t"].means == {1: 10, 2: 20, 4: 40}
    assert found.effects["t"].compared == 3
    assert found.effects["e"].means == {10: 30, 20: 60, 40: 120}
    assert found.effects["e"].compared == 6
    plain = [np.mean([v for v, (_, h) in zip(values, points, strict=True) if h == at and v])
             for at in (10, 20, 40)]  # fmt: skip
    assert plain[2] / plain[0] > 5, "averages over holes make four times the hardness five times it"


def test_a_level_without_designs_is_a_gap_and_takes_no_other_out() -> None:
    points = grid([1, 2, 4], [10, 20])
    t, e = (list(column) for column in zip(*points, strict=True))
    values = [None if a == 1 else float(a * b) for a, b in points]
    found = sensitivity({"t": t, "e": e}, values, grid=True)
    assert found.effects["t"].means == {1: None, 2: 30, 4: 60} and found.effects["t"].compared == 4


def test_designs_without_partners_have_no_share() -> None:
    points = grid([1, 2], [10, 20])
    t, e = (list(column) for column in zip(*points, strict=True))
    found = sensitivity({"t": t, "e": e}, [1.0, None, None, 4.0], grid=True).effects["t"]
    assert found.compared == 0 and found.share is None and found.means == {1: None, 2: None}
