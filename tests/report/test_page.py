# SPDX-License-Identifier: Apache-2.0
"""Pages of calibrations and profiles: complete, self-contained, never half written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.calibration.report.profile_page import profile_page
from taccel_lab.errors import InputError
from taccel_lab.profile import DepthResponseBlock, Provenance
from taccel_lab.report.page import Page, Picture, Table, to_do_first, write_page
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.report.style import new_figure
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.synthetic_presses import GRID, tiny_profile


def test_a_page_shows_its_verdict_and_escapes_text(tmp_path: Path) -> None:
    page = Page(
        "Fit <of> things",
        "A summary.",
        remarks=[Remark(Severity.WARNING, "few", "only 3 frames")],
        tables=[Table("Numbers", ("name", "value"), [("x", 1.23456789), ("y", None)])],
        pictures=[Picture("empty", lambda: new_figure(2, 2)[0], "Nothing.")],
        figures={"x": 1.5},
    )
    write_page(page, tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Fit &lt;of&gt; things" in html and "Verdict: usable" in html and "1.235" in html
    assert "data:image/png;base64," in html and "http" not in html
    data = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert data["x"] == 1.5 and data["remarks"][0]["code"] == "few"


def test_a_failing_picture_leaves_the_earlier_page(tmp_path: Path) -> None:
    write_page(Page("first", ""), tmp_path / "out")

    def fail() -> None:
        raise RuntimeError("no picture")

    with pytest.raises(RuntimeError):
        write_page(Page("second", "", pictures=[Picture("p", fail, "")]), tmp_path / "out")  # type: ignore[arg-type]
    assert "first" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_foreign_files_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="did not write"):
        write_page(Page("x", ""), tmp_path)


def test_the_page_of_a_profile_tells_each_block_and_its_evidence(tmp_path: Path) -> None:
    profile = catalogue_profile("gelsight_mini")
    material = profile.material.replace(
        young_modulus_pa=2e5,
        provenance=Provenance(
            kind="calibrated",
            method="fit",
            source="bench",
            inputs={"record.csv": "0" * 64},
            residuals={"force_rms_relative": 0.0123},
            valid_region={"force_n": (0.0, 20.0)},
            spread={"young_modulus_pa": 4e3},
            interval={"poisson_ratio": (0.4711, 0.4899)},
            correlation={"young_modulus_pa*poisson_ratio": -0.87},
            verdict="weak",
            remarks=("the record does not tell nu",),
        ),
    )
    page = profile_page(profile.with_block(material))
    write_page(page, tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for text in ("Verdict: weak", "0.0123", "0.4711 to 0.4899", "-0.87", "does not tell nu"):
        assert text in html
    for key in profile.blocks():
        assert f"<h2>{key}</h2>" in html


def test_the_verdict_is_followed_by_three_things_to_do_at_most(tmp_path: Path) -> None:
    remarks = [
        Remark(Severity.INFO, "a", "just so"),
        Remark(Severity.WARNING, "block_state", "color: usable, with reservations"),
        *(Remark(Severity.WARNING, "b", f"warning {k}") for k in range(4)),
        Remark(Severity.ERROR, "c", "the worst"),
    ]
    first, others = to_do_first(remarks)
    assert [r.message for r in first] == ["the worst", "warning 0", "warning 1"]
    assert [r for r in remarks if r not in first] == others and len(others) == 4
    write_page(Page("x", "", remarks=remarks), tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    places = [html.index(t) for t in ("Verdict: weak", "To do first", "the worst", "4 more remarks",
                                      "just so")]  # fmt: skip
    assert places == sorted(places)
    assert html.count("<ol>") == 1 and html.count("<li>") == len(remarks)


def test_blocks_are_folded_after_the_pictures_and_long_sources_too(tmp_path: Path) -> None:
    source = "measured on the bench by a person who writes long sentences, " * 3
    tables = [
        Table("Evidence", ("name", "value", "never known"), [("x", 1, None)], folded=True),
        Table("Sources", ("of", "source"), [("y", source)]),
    ]
    pictures = [Picture("p", lambda: new_figure(2, 2)[0], "A picture.")]
    write_page(Page("x", "", tables=tables, pictures=pictures), tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    places = [html.index(text) for text in ("<h2>Sources", "A picture.", "<summary><h2>Evidence")]
    assert places == sorted(places)
    assert "never known" not in html
    assert source in html and f"<td>{source}" not in html and '<details class="long">' in html


def test_what_several_blocks_remark_is_said_once_and_as_grave_as_it_is() -> None:
    profile = catalogue_profile("gelsight_mini")

    def remarking(block: Any) -> Any:
        where = block.provenance.model_copy(
            update={"remarks": ("warning: the light drifts", "info: as always")}
        )
        return block.replace(provenance=where)

    profile = profile.with_block(remarking(profile.camera)).with_block(remarking(profile.material))
    said = {r.message: r.severity for r in profile_page(profile).remarks}
    assert said["material, camera: the light drifts"] == Severity.WARNING
    assert said["material, camera: as always"] == Severity.INFO


def test_a_depth_curve_is_drawn(tmp_path: Path) -> None:
    provenance = Provenance(kind="measured", method="m", source="s", spread={"depth_mm": 0.05})
    block = DepthResponseBlock(drop_levels=(0.0, 40.0), depth_mm=(0.0, 1.2), provenance=provenance)
    write_page(profile_page(tiny_profile(GRID).with_block(block)), tmp_path / "out")
    assert (tmp_path / "out" / "depth_response.png").stat().st_size > 5000
