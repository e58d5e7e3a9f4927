# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job end to end, on captures small enough for a test."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.photo import PressPhoto
from taccel_lab.profile import SensorProfile, load_profile, validate_profile
from taccel_lab.scene import Element
from tests.support.commands import refusal, run
from tests.support.small_captures import (
    CIRCLES,
    GRID,
    everything_below,
    never,
    write_captures,
)

FIT = "taccel_lab.calibration.color.fit"
NORMALS = "taccel_lab.calibration.normals.fit"


def short_fit(**settings: Any) -> ColorFitOptions:
    return ColorFitOptions(**settings | {"steps": 200})


def short_normals(**settings: Any) -> InverseFitOptions:
    return InverseFitOptions(**settings | {"steps": 100, "synthetic_presses": 8})


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


@pytest.fixture(scope="module")
def readers() -> list[SensorProfile]:
    """Profiles by which photos were read, to be simulated by the same."""
    return []


@pytest.fixture(scope="module")
def words(
    tmp_path_factory: pytest.TempPathFactory, readers: list[SensorProfile]
) -> Iterator[list[object]]:
    """The command of a demo; its presses may have any accuracy, as ``test_press`` has the files."""
    root = tmp_path_factory.mktemp("demo")
    captures = write_captures(root / "captures")
    read = PressPhoto.read

    def watched(profile: SensorProfile, *rest: Any) -> PressPhoto:
        readers.append(profile)
        return read(profile, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PressPhoto, "read", watched)
        patch.setattr(f"{FIT}.ColorFitOptions", short_fit)
        patch.setattr(f"{NORMALS}.ColorFitOptions", short_fit)
        patch.setattr(f"{NORMALS}.InverseFitOptions", short_normals)
        patch.setattr(f"{NORMALS}.CHECKED", 2)
        quick = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
        patch.setitem(PHYSICS, Accuracy.DEFAULT, quick)
        yield ["demo", "--captures", captures, "--out", root / "out" / "demo"]


@pytest.fixture(scope="module")
def out(words: list[Any]) -> Path:
    """Its output after an interrupt in the fit of colours, and the same command again."""
    out = words[4]
    unfinished = out.with_name("demo_unfinished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{FIT}.fit_color_model", interrupt)
        assert run(*words) == 130
    assert os.listdir(out.parent) == [unfinished.name]
    assert list(json.loads((unfinished / "calibration.json").read_text())["blocks"]) == [
        "background"
    ]
    assert load_profile(unfinished / "profile").background is not None
    page = (unfinished / "report" / "background" / "report.html").stat()
    assert run(*words) == 0
    again = (out / "report" / "background" / "report.html").stat()
    assert (again.st_size, again.st_mtime_ns) == (page.st_size, page.st_mtime_ns)
    return out


@pytest.mark.thorough
def test_the_profile_is_scored_on_what_it_had_not_seen(out: Path) -> None:
    folders = {"photos", "presses", "profile", "report"}
    assert {path.name for path in out.iterdir()} == {OUTPUT_MARKER, *folders}
    assert os.listdir(out.parent) == ["demo"]
    assert validate_profile(out / "profile") == []
    profile = load_profile(out / "profile")
    assert profile.color is not None and profile.grid() == GRID
    color = json.loads((out / "report" / "color" / "report.json").read_text())["color"]
    assert color["heldout"]["disc_l1"] < 0.6 * color["background_only"]["disc_l1"]
    assert color["heldout"]["crop_psnr_db"] > color["background_only"]["crop_psnr_db"] + 3
    assert [row["name"] for row in color["presses"]] == ["p0"]
    left = profile.color.provenance.residuals
    assert left["heldout_disc_l1"] == pytest.approx(color["heldout"]["disc_l1"])
    assert left["heldout_presses"] == 1
    bare = color["background_only"]["crop_psnr_db"]
    assert left["background_crop_psnr_db"] == pytest.approx(bare)
    assert set(profile.color.provenance.inputs) >= {"background", "p1", "p2", "p3", "p4"}


@pytest.mark.thorough
def test_the_page_opens_with_a_held_out_photo_beside_its_simulation(out: Path) -> None:
    html = (out / "report" / "report.html").read_text(encoding="utf-8")
    order = ("p0: ", "photo</figcaption>", "simulation of the press", "difference x 2",
             "depth read from the photo", "dB</small>", "degrees</small>", "mm</small>",
             "N</small>", "To do first", "<h2>Blocks</h2>")  # fmt: skip
    places = [html.index(text) for text in order]
    assert places == sorted(places)
    assert "these captures have no forces" in html
    assert not any(outside in html for outside in ('src="http', "src='http", 'href="http'))
    links = set(re.findall(r'href="([^"]+)"', html))
    wanted = {"../profile/", "../presses/p0/report.html", "../photos/p0.png", "color/report.html",
              "color/heldout.png", "normals/report.json", "background/report.html"}  # fmt: skip
    assert wanted <= links
    assert all((out / "report" / link).exists() for link in links)
    photo = cv2.imread(str(out / "photos" / "p0.png"))
    assert np.array_equal(photo, cv2.imread(str(out.parents[1] / "captures" / "p0.png")))


@pytest.mark.thorough
def test_what_reads_and_paints_the_photo_was_not_fitted_to_it(
    out: Path, readers: list[SensorProfile]
) -> None:
    (used,) = readers
    profile = load_profile(out / "profile")
    for key in ("color", "normals"):
        assert "p0" not in used.blocks()[key].provenance.inputs
        assert "p0" in profile.blocks()[key].provenance.inputs
    press = json.loads((out / "presses" / "p0" / "press.json").read_text())
    like = press["like"]
    assert (out / "presses" / "p0" / like["photo"]).samefile(out / "photos" / "p0.png")
    assert like["psnr_db"] > like["untouched_psnr_db"] + 3 and press["press"]["force_n"] > 0
    # Nor is its label: the place is read.
    middle = GRID.gel_from_pixel(np.array([CIRCLES[0].u_px, CIRCLES[0].v_px]))
    assert 0 < np.abs(np.array(like["at_mm"]) - middle).max() < 0.2


@pytest.mark.thorough
def test_an_interrupted_demonstration_leaves_an_earlier_one(
    out: Path, words: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = everything_below(out)
    monkeypatch.setattr(f"{FIT}.fit_color_model", interrupt)
    assert run(*words) == 130
    assert everything_below(out) == before
    assert sorted(os.listdir(out.parent)) == ["demo", "demo_unfinished"]


@pytest.mark.parametrize(
    ("kept", "said"),
    [(0, "has no ball presses"), (2, "too few to hold out one in 4")],
)
def test_captures_that_leave_no_photo_are_refused_at_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kept: int,
    said: str,
) -> None:
    monkeypatch.setattr("taccel_lab.calibration.calibrate.calibrate", never)
    made = write_captures(tmp_path / "captures")
    head, *presses = (made / "captures.toml").read_text().split("[[presses]]")
    (made / "captures.toml").write_text("[[presses]]".join([head, *presses[:kept]]))
    assert said in refusal(capsys, "demo", "--captures", made, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
