# SPDX-License-Identifier: Apache-2.0
"""Every kind of page, as small as it gets: nothing runs over on screens nor on paper, and no text
of a figure is cut."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import taccel_lab.report.page as page_module
from taccel_lab.benchmarks.results import benchmark_page, read_result
from taccel_lab.calibration.background.background_page import background_page
from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.camera.camera_page import camera_page
from taccel_lab.calibration.camera.fit import calibrate_camera
from taccel_lab.calibration.capture import load_capture_folder
from taccel_lab.calibration.capture.importers import import_folders
from taccel_lab.calibration.check import check_captures, check_page
from taccel_lab.calibration.depth.depth_page import depth_page
from taccel_lab.calibration.depth.fit import fit_depth
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.import_options import ImportOptions
from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.calibration.scale.scale_page import scale_page
from taccel_lab.exporters.published_meshes import data_folder
from taccel_lab.learning.force.fit import calibrate_force
from taccel_lab.learning.force.force_page import force_page
from taccel_lab.report.page import write_page_file
from taccel_lab.report.readings_page import readings_page
from taccel_lab.sensors.profile import catalogue_profile, stock_sensor
from taccel_lab.studies.evaluate.runner import run_study
from taccel_lab.studies.report import write_study_report
from tests.calibration.depth.test_depth import CIRCLES, captures_of
from tests.learning.force.conftest import QUICK
from tests.learning.force.small_touches import planned, write_touches
from tests.report.test_page_in_browser import WIDER
from tests.support.fake_kit import study
from tests.support.small_captures import write_captures
from tests.support.small_data_sets import saved_profile
from tests.viewer.browser import chromium_page

pytestmark = pytest.mark.rasterised

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
PARTLY_SHOWN = """() => [...document.querySelectorAll('section *')].filter(e => {
    const box = e.getBoundingClientRect(), card = e.closest('section').getBoundingClientRect();
    return box.width > 0 && (box.right > card.right + 1 || box.left < card.left - 1);
  }).map(e => e.tagName + ' ' + (e.innerText || e.className).slice(0, 60))"""
OUTSIDE = """() => [...document.querySelectorAll('section *')].filter(e => {
    const box = e.getBoundingClientRect(), card = e.closest('section').getBoundingClientRect();
    const out = box.right > card.right + 1 || box.left < card.left - 1;
    return box.width > 0 && out && !e.closest('.scroll *');
  }).map(e => e.tagName + ' ' + (e.innerText || e.className).slice(0, 60))"""
"""What leaves its card, but for the inner parts of tables, which scroll inside it."""
SCREENS = ((1280, "screen"), (1600, "screen"), (690, "print"))
"""Widths [px], and for what; A4 between its margins is 690 px wide."""


def profile(folder: Path) -> None:
    write_page_file(profile_page(stock_sensor("gelsight_mini")), folder / "profile.html")


def many_columns(folder: Path) -> None:
    ranges = {
        "thickness_mm": {"min": 3, "max": 6, "count": 2},
        "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 2, "scale": "log"},
        "width_px": {"values": [320, 640]},
    }
    write_study_report(run_study(study(parameters=ranges), folder / "study", processes=0))
    (folder / "study" / "report.html").rename(folder / "study.html")


def captures(folder: Path) -> None:
    made = write_captures(folder / "captures")
    # Two of its presses: a page of more has longer tables, which take seconds a press to fill.
    head, *presses = (made / "captures.toml").read_text().split("[[presses]]")
    (made / "captures.toml").write_text("[[presses]]".join([head, *presses[:2]]))
    check = check_captures(load_capture_folder(made))
    write_page_file(check_page(check), folder / "check.html")


def backgrounds(folder: Path) -> None:
    captures = load_capture_folder(write_captures(folder / "untouched"))
    found = calibrate_background(captures, catalogue_profile(captures.sensor))
    write_page_file(background_page(found), folder / "background.html")


def grey_depth(folder: Path) -> None:
    found = fit_depth(captures_of(CIRCLES, noise=1.0), DepthOptions(zero="rim"))
    write_page_file(depth_page(found), folder / "depth.html")


def forces(folder: Path) -> None:
    touches = write_touches(planned(saved_profile(folder / "pad"), episodes=16), folder / "touches")
    found = calibrate_force(touches, options=replace(QUICK, steps=3))
    write_page_file(force_page(found), folder / "force.html")


def readings(folder: Path) -> None:
    for name in ("a", "b"):
        Image.new("RGB", (1100, 300)).save(folder / f"{name}.png")
    lines = {
        name: (f"{name}.png: 1.925 +- 0.277 mm deep at (77, 182) px, 28.01 mm2 touched",
               "5.2 N (95 %: 2.1 to 12.2 N), 14.12 mm2 in contact, pressure up to 449 kPa")
        for name in ("a", "b")
    }  # fmt: skip
    page = readings_page("Depths read from images", lines, {"c": "c.png is no image"}, folder)
    write_page_file(page, folder / "readings.html")


def real_boards_and_edges(folder: Path) -> None:
    """Of real captures, where they are on this machine."""
    board = ImportOptions(board="dots:9x7:2.5")
    for name, layout, options in (
        ("9dtact_official", "auto", board),
        ("gsmini_cube_edges", "cube-edges", ImportOptions()),
    ):
        if not (data_folder() / name).exists():
            continue
        import_folders(data_folder() / name, folder / name, layout, options)
        part = folder / name / "sensor_1" if options is board else folder / name
        captures = load_capture_folder(part)
        base = catalogue_profile(captures.sensor)
        if options is board:
            page = camera_page(calibrate_camera(captures, base), captures)
        else:
            page = scale_page(calibrate_scale(captures, base), captures)
        write_page_file(page, folder / f"{name}.html")


def benchmarks(folder: Path) -> None:
    for name in ("captures", "press_accuracy"):
        page = benchmark_page(read_result(RESULTS / f"{name}.json"))
        write_page_file(page, folder / f"benchmark_{name}.html")


MAKERS: tuple[Callable[[Path], None], ...] = (
    profile, many_columns, captures, benchmarks, backgrounds, grey_depth, forces, readings,
    real_boards_and_edges,
)  # fmt: skip


@pytest.fixture(scope="module")
def cut_texts():
    """Texts of figures that do not fit into them, of all pages."""
    return []


@pytest.fixture(scope="module")
def pages(tmp_path_factory, cut_texts):
    folder = tmp_path_factory.mktemp("pages")
    save = page_module.save_figure_to

    def watched(figure, *rest):
        save(figure, *rest)  # type: ignore[arg-type]
        cut_texts.extend(_cut(figure))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_module, "save_figure_to", watched)
        for make in MAKERS:
            make(folder)
    yield sorted(folder.glob("*.html"))


def _cut(figure: Figure) -> Iterator[str]:
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    width, height = figure.canvas.get_width_height()
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if not text.get_visible() or not text.get_text().strip() or text.get_clip_on():
            continue
        box = text.get_window_extent(renderer)
        if box.x0 < -1 or box.y0 < -1 or box.x1 > width + 1 or box.y1 > height + 1:
            yield text.get_text()


@pytest.mark.thorough
def test_no_page_runs_over_on_screens_nor_on_paper(pages):
    assert len(pages) >= len(MAKERS) - 1
    found: list[str] = []
    with chromium_page("about:blank", (1280, 900)) as page:
        for path in pages:
            page.goto(path.as_uri())
            page.evaluate("document.querySelectorAll('details').forEach(e => e.open = true)")
            for width, media in SCREENS:
                page.emulate_media(media=media)
                page.set_viewport_size({"width": width, "height": 900})
                for check in (WIDER, PARTLY_SHOWN):
                    found += [f"{path.name}, {width} px: {e}" for e in page.evaluate(check)]
    assert not found


@pytest.mark.thorough
def test_on_a_phone_nothing_leaves_its_card(pages):
    found: list[str] = []
    with chromium_page("about:blank", (390, 844)) as page:
        for path in pages:
            page.goto(path.as_uri())
            page.evaluate("document.querySelectorAll('details').forEach(e => e.open = true)")
            found += [f"{path.name}: {e}" for e in page.evaluate(OUTSIDE)]
            width = page.evaluate("document.documentElement.scrollWidth")
            found += [f"{path.name} is {width} px wide"] * (width > 390)
    assert not found


@pytest.mark.thorough
def test_texts_of_figures_are_whole(pages, cut_texts):
    assert pages and not cut_texts
