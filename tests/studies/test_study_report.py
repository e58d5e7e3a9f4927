# SPDX-License-Identifier: Apache-2.0
"""The report of a study: what it says, that its pictures are there and hold something."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.runner import Outcome, run_study
from tests.support.fake_kit import evaluate_and_tear, study, table

SQUARE = {
    "thickness_mm": {"min": 3, "max": 6, "count": 3},
    "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 3, "scale": "log"},
}


class Page(HTMLParser):
    """Ids, links and pictures of a page; complains about tags that are not closed in order."""

    VOID = ("meta", "img", "br", "link", "input", "hr")

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


def report(root: Path, **changes: Any) -> tuple[Outcome, dict[str, Any]]:
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


def test_the_row_of_another_design_is_no_row(tmp_path: Path) -> None:
    outcome, _ = report(tmp_path, parameters=SQUARE)
    first, second = outcome.folder.ids()[:2]
    row = outcome.folder.design(first) / "result.json"
    row.write_text((outcome.folder.design(second) / "result.json").read_text())
    with pytest.raises(InputError, match=f"is that of another design, {second}"):
        outcome.folder.read(first)


def test_a_grid_of_two_parameters_has_everything(tmp_path: Path) -> None:
    outcome, values = report(tmp_path, parameters=SQUARE)
    assert drawn(tmp_path) == {
        "pareto", "pairs", "parallel", "sensitivities", "effects", "maps", "curves",
    }  # fmt: skip
    page, text = page_of(tmp_path)
    assert len(page.pictures) == 7
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


def modulus_free_share(outcome: Outcome) -> float:
    """Share of the thickness in the variance of the range, of the designs at 0.1 and 0.2 MPa."""
    kept = [row for row in outcome.rows if row.parameters["young_modulus_mpa"] < 0.4]
    y = np.array([row.figures["range"] for row in kept], dtype=float).reshape(3, 2)
    return float(y.mean(axis=1).var() / y.var())


def test_designs_are_called_by_their_values(tmp_path: Path) -> None:
    outcome, values = report(tmp_path, parameters=SQUARE)
    best = values["names"][values["best"][0]]
    assert best == "thickness 6 mm, young modulus 0.1 MPa"
    assert f"has {best}." in values["verdict"]["sentences"][0]
    _, text = page_of(tmp_path)
    assert f"</span> {best}</h3>" in text
    # A hash stands once, in the last column of the table of all designs: the design's folder.
    for row in outcome.rows:
        assert text.count(row.id) == 1 and f"<td><code>{row.id}</code></td></tr>" in text


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
    assert "No design keeps the constraints" in text and values["names"][nearest["design"]] in text


def test_an_unfinished_study_says_so(tmp_path: Path) -> None:
    outcome = run_study(study(parameters=SQUARE), tmp_path, processes=0, limit=5)
    verdict = write_study_report(outcome)["verdict"]
    assert verdict["headline"] == "5 of 9 designs are done" and not verdict["good"]
    page_of(tmp_path)


def test_random_sweeps_and_single_designs_have_reports(tmp_path: Path) -> None:
    ranges = {"thickness_mm": {"min": 3, "max": 6}, "width_px": {"min": 300, "max": 700}}
    _, values = report(
        tmp_path / "random", parameters=ranges, sweep={"kind": "random", "count": 12}
    )
    effects = values["sensitivities"]["stiffness"]["effects"]
    assert effects["thickness_mm"]["rank"] == pytest.approx(-1)
    assert abs(effects["width_px"]["elasticity"]) < 1e-6
    assert "maps" not in drawn(tmp_path / "random")
    _, values = report(tmp_path / "one", parameters={"thickness_mm": {"values": [4]}})
    assert drawn(tmp_path / "one") == set() and values["verdict"]["good"]
    for name in ("random", "one"):
        page_of(tmp_path / name)


def test_no_figures_at_all(tmp_path: Path) -> None:
    _, values = report(tmp_path, parameters={"rim": {"values": ["fillet"]}})
    assert values["verdict"]["headline"] == "No design has figures"
    page_of(tmp_path)


def test_texts_of_the_study_are_escaped(tmp_path: Path) -> None:
    named = {**table()["study"], "name": "<b>bold</b> & more"}
    report(tmp_path, study=named, parameters={"thickness_mm": {"values": [4, 5]}})
    _, text = page_of(tmp_path)
    assert "&lt;b&gt;bold&lt;/b&gt; &amp; more" in text and "<b>bold" not in text


def test_figures_of_an_earlier_report_go(tmp_path: Path) -> None:
    report(tmp_path, parameters=SQUARE)
    report(tmp_path, parameters={"thickness_mm": {"values": [4]}})
    assert drawn(tmp_path) == set()
