# SPDX-License-Identifier: Apache-2.0
"""The written report: self-contained page, JSON keys, sections, and what its verdict says."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from taccel_lab.report import write_report
from taccel_lab.report.build import format_number
from taccel_lab.report.model import Report, Target
from taccel_lab.report.values import look_up, report_values
from taccel_lab.report.verdict import Verdict, judge_targets, reach_verdict
from tests.report.sample_report import full_report, press


class _Page(HTMLParser):
    """Tags, image sources, alt texts and links of a page; fails on unbalanced tags."""

    VOID = frozenset({"meta", "img", "br", "link", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.ids: set[str] = set()
        self.tags: set[str] = set()
        self.loaded: list[str | None] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.tags.add(tag)
        if "id" in values:
            self.ids.add(values["id"])
        if tag != "img" and "src" in values:
            self.loaded.append(values["src"])
        if tag == "img":
            self.images.append(values)
        if tag == "a":
            self.links.append(values["href"])
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    write_report(full_report(), folder)
    return folder


def test_page_is_well_formed_and_self_contained(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    page = _Page(text)
    assert len(page.images) == len(list((written / "figures").glob("*.png"))) >= 14
    for image in page.images:
        kind, data = image["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data, validate=True).startswith(b"\x89PNG")
        assert len(image["alt"]) > 15
    # Its one script stands in the page.
    assert not page.tags & {"link", "iframe"} and page.loaded == []
    assert "http" not in re.sub(r"base64,[^\"]+", "", text)
    assert {link.lstrip("#") for link in page.links} <= page.ids
    assert "Sample &lt;report&gt;" in text


def test_json_holds_the_required_keys(written):
    values = json.loads((written / "report.json").read_text())
    for name in ("heldout", "background_only"):
        keys = {"crop_psnr_db", "crop_ssim", "disc_l1", "full_l1"}
        assert keys <= values["color"][name].keys()
    press = values["press"]
    assert press["force_n"] == 2.0
    assert press["min_distance_m"] == 4e-6 and press["smallest_distance_m"] == 3e-6
    assert {"residual_n", "newton_iterations", "seconds_per_step"} <= press.keys()
    assert values["mesh"]["node_count"] == 4 and values["mesh"]["tet_count"] == 1
    assert values["mesh"]["min_dihedral_deg"] == 35.3
    assert sum(values["mesh"]["dihedral_histogram"]["counts"]) == 6
    assert values["total_s"] == 6.0
    assert values["color"]["gain_over_background"]["crop_psnr_db"] == pytest.approx(12.3)


def test_frames_are_listed_worst_first(written):
    values = json.loads((written / "report.json").read_text())
    worst_first = ["press 1", "press 0", "press 2"]
    assert [frame["name"] for frame in values["color"]["frames"]] == worst_first
    text = (written / "report.html").read_text(encoding="utf-8")
    places = [text.index(f"<b>{name}</b>") for name in worst_first]
    assert places == sorted(places)


def test_detection_errors_leave_out_what_was_not_found(written):
    detection = json.loads((written / "report.json").read_text())["detection"]
    assert (detection["found"], detection["count"]) == (2, 3)
    assert detection["center_error_px"] == {"median": 2.0, "p90": pytest.approx(2.8), "max": 3.0}
    assert detection["radius_bias_px"] == pytest.approx(-0.25)
    assert detection["frames"][2]["detected_px"] == [None, None, None]


def test_detection_can_be_left_out(tmp_path):
    write_report(replace(full_report(), detection=None), tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = _Page(text)
    assert {link.lstrip("#") for link in page.links} <= page.ids
    assert json.loads((tmp_path / "report.json").read_text())["detection"] is None


def test_a_failed_report_leaves_no_page(tmp_path):
    frame = full_report().color.frames[0]
    broken = replace(frame, rendered_rgb=frame.rendered_rgb[:-7])
    color = replace(full_report().color, frames=(broken,))
    with pytest.raises(ValueError, match=r"broadcast|shape"):
        write_report(replace(full_report(), color=color), tmp_path)
    assert not (tmp_path / "report.html").exists()
    assert not (tmp_path / "report.json").exists()


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (float("nan"), "–"), (12345, "12,345"), (3.0e-6, "3.00e-06"), (0.145, "0.145"),
     ("structured", "structured"), (True, "True"), (0.0, "0")],
)  # fmt: skip
def test_number_format(value, text):
    assert format_number(value) == text and format_number(2, 2) == "2.00"


TEMPLATES = [
    path
    for path in Path(__file__).parents[2].rglob("templates/*.j2")
    if not {"tests", ".venv"} & set(path.parts)
]


assert len(TEMPLATES) == 6


@pytest.mark.parametrize("path", TEMPLATES, ids=lambda path: path.name)
def test_values_stand_in_templates_where_escaping_makes_them_text(path: Path) -> None:
    """In text and between quotes: never marked as safe, in scripts, handlers or addresses, and in
    styles and sources only what we have made ourselves."""
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"\|\s*safe|autoescape|Markup|\bon\w+\s*=", text)
    plain = re.sub(r"\{\{.*?\}\}", "VALUE", re.sub(r"\{%.*?%\}", "", text))
    outside = re.sub(r'"[^"]*"', "", plain)
    assert not re.search(r"<[^<>]*=\s*VALUE", outside)
    for part in re.findall(r"<(?:script|style).*?</(?:script|style)>", text, re.DOTALL):
        assert "{{" not in part
    assert not re.search(r'(?:href|action|srcdoc)="[^"#]*\{\{', text)
    values = re.findall(r'(?:src|style)="[^"]*\{\{\s*("[^"]*"|[\w.]+)', text)
    assert set(values) <= {"src", "color", '"%.1f"', "frame.image", "frame.depth"}


def test_names_of_a_report_are_text(written: Path, tmp_path: Path) -> None:
    attack = "</title></script><img src=x onerror=alert(1)>\"'"
    report = full_report()
    frames = tuple(replace(frame, name=attack) for frame in report.color.frames)
    report = replace(
        report,
        title=attack,
        remarks=(attack,),
        provenance={attack: attack},
        color=replace(report.color, frames=frames, facts={attack: attack}),
    )
    write_report(report, tmp_path)
    shown, known = (
        _Page((folder / "report.html").read_text(encoding="utf-8"))
        for folder in (tmp_path, written)
    )
    assert shown.tags == known.tags and len(shown.images) == len(known.images)
    assert all(image["src"].startswith("data:image/png;base64,") for image in shown.images)


def _verdict(report: Report) -> Verdict:
    values = report_values(report)
    return reach_verdict(report, values, judge_targets(report, values))


def test_targets_are_judged_in_their_direction():
    report = full_report()
    psnr, disc, unknown = judge_targets(report, report_values(report))
    assert (psnr.met, disc.met, unknown.met) == (False, True, False)
    assert psnr.value == 33.3 and psnr.baseline == 21.0
    assert abs(psnr.shortfall - 0.7) < 1e-9 and disc.shortfall < 0
    assert unknown.value is None and unknown.shortfall is None
    assert (psnr.goal_text, disc.goal_text) == ("≥ 34.0 dB", "≤ 2.60 levels")


def test_a_shortfall_comes_with_number_and_cause():
    verdict = _verdict(full_report())
    assert not verdict.good and verdict.headline == "1 of 3 targets are met"
    assert (
        "Falls short: crop PSNR is 33.3 dB, 0.7 dB from the goal of ≥ 34.0 dB."
        in (verdict.sentences[0])
    )
    assert verdict.sentences[0].endswith("Likely cause: too dark.")
    assert verdict.sentences[1].startswith("Not measured: something else")
    assert "Met: L1 in the disc 2.50 levels (goal ≤ 2.60 levels)." in verdict.sentences
    assert any("12.3 dB closer" in sentence for sentence in verdict.sentences)
    assert "A remark." in verdict.sentences


def test_all_met_is_good():
    report = replace(full_report(), targets=(Target("mesh.min_dihedral_deg", "angle", 10, True),))
    verdict = _verdict(report)
    assert verdict.good and verdict.headline == "All 1 targets are met"


def test_trouble_in_the_simulation_spoils_the_verdict():
    report = full_report()
    target = (Target("mesh.min_dihedral_deg", "angle", 10, True),)
    pierced = replace(report.press, records=(press("press 7", 1.0, min_distance_m=0.0),))
    verdict = _verdict(replace(report, targets=target, press=pierced))
    assert not verdict.good and "trouble" in verdict.headline
    assert any("intersect" in sentence for sentence in verdict.sentences)


def test_a_rendering_worse_than_the_background_says_so():
    report = full_report()
    color = replace(report.color, heldout=replace(report.color.heldout, crop_psnr_db=19.0))
    verdict = _verdict(replace(report, color=color))
    assert any("2.0 dB further from the capture" in sentence for sentence in verdict.sentences)


def test_look_up_takes_numbers_only():
    values = {"a": {"b": 2, "c": "text", "d": None, "e": float("nan"), "f": True}}
    assert look_up(values, "a.b") == 2.0
    for key in ("a.c", "a.d", "a.e", "a.f", "a.b.c", "x", "a"):
        assert look_up(values, key) is None
