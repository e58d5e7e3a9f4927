# SPDX-License-Identifier: Apache-2.0
"""The written report: self-contained page, JSON keys, figures, sections that are left out."""

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
from tests.report.sample_report import full_report


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
    assert [frame["name"] for frame in values["color"]["frames"]] == [
        "press 1",
        "press 0",
        "press 2",
    ]
    text = (written / "report.html").read_text(encoding="utf-8")
    places = [text.index(f"<b>press {i}</b>") for i in (1, 0, 2)]
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
    assert format_number(value) == text


def test_number_format_with_digits():
    assert format_number(2, 2) == "2.00"


TEMPLATES = [
    path
    for path in Path(__file__).parents[2].rglob("templates/*.j2")
    if not {"tests", ".venv"} & set(path.parts)
]


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


def test_there_are_templates_to_look_at() -> None:
    assert len(TEMPLATES) == 6


def test_names_of_a_report_are_text(tmp_path: Path) -> None:
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
    plain = tmp_path / "plain"
    write_report(full_report(), plain)
    shown, known = (
        _Page((folder / "report.html").read_text(encoding="utf-8")) for folder in (tmp_path, plain)
    )
    assert shown.tags == known.tags and len(shown.images) == len(known.images)
    assert all(image["src"].startswith("data:image/png;base64,") for image in shown.images)
