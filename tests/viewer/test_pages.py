# SPDX-License-Identifier: Apache-2.0
"""Pages in headless Chromium: they show something, and answer."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.viewer.design_answer import DesignAnswers
from taccel_lab.viewer.design_controls import DesignControls
from taccel_lab.viewer.design_page import DesignPage
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.page_parts import look_at
from tests.viewer.browser import (
    chromium_page,
    middle,
    picture,
    shared_browser,  # noqa: F401
    wait_for,
)

pytest.importorskip("viser", reason="the extra view is not installed")
pytestmark = pytest.mark.usefixtures("shared_browser")
HERE = PageOptions(port=0, browser=False)


def dented_block() -> GelStates:
    """A block whose middle sinks in three states."""
    mesh = block_mesh((8, 8, 3), (0.024, 0.024, 0.006))
    rest = 1e3 * mesh.nodes_m
    dent = np.exp(-(rest[:, 0] ** 2 + rest[:, 1] ** 2) / 18) * (rest[:, 2] + 6) / 6
    moved = np.zeros((3, *rest.shape))
    moved[1:, :, 2] = -np.outer([0.5, 1.0], dent)
    forces = np.zeros_like(moved)
    forces[..., 2] = 0.01 * moved[..., 2]
    grey = np.full((3, 24, 32, 3), 90, dtype=np.uint8)
    return GelStates(
        rest_mm=rest,
        tets=mesh.tets.astype(np.int64),
        faces=mesh.faces.astype(np.int64),
        moved_mm=moved,
        captions=["untouched", "half", "whole"],
        fields=[Field("contact pressure", "kPa", -moved[..., 2])],
        forces_n=forces,
        images=SensorImages(grey, np.full((3, 2, 2), 10.0)),
    )


@pytest.mark.thorough
def test_a_gel_is_seen_with_section_arrows_and_states():
    with live_page("A press", HERE) as server:
        states = dented_block()
        look_at(server, states.rest_mm)
        view = GelView(server, states)
        with chromium_page(page_address(server)) as page:
            page.get_by_text("untouched", exact=True).wait_for()
            wait_for(page, lambda: middle(page).std() > 10)
            whole = middle(page).astype(float)
            view.choose(state=2, cut="across y", arrows="by node")
            page.get_by_text("whole", exact=True).wait_for()
            wait_for(page, lambda: np.abs(middle(page) - whole).mean() > 3)
            # By the page itself: the other way round, the slider tells the view.
            page.get_by_text("first", exact=True).click()
            page.get_by_text("untouched", exact=True).wait_for()
            assert view.time.state == 0
            page.get_by_text("An arrow of").wait_for()
            page.get_by_text("[kPa]").wait_for()
            # A click on the gel reads the field there: the section lies at y = 0, in the middle.
            box = page.locator("canvas").first.bounding_box()
            note = page.get_by_text(re.compile(r"kPa at \(.*\) mm"))
            place = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

            def clicked():
                page.mouse.click(*place)
                page.wait_for_timeout(500)
                return note.count() > 0

            wait_for(page, clicked)
            x, y, z = map(float, re.findall(r"-?\d+\.\d+", note.inner_text().split("at (")[1]))
            assert max(abs(x), abs(y)) < 2 and -6.1 < z < 0.1


@contextmanager
def design_page(out: Path, options: PageOptions = HERE) -> Iterator[tuple[Any, DesignPage]]:
    """A page of the flat pad with its server; closing it ends what is under way."""
    answers = DesignAnswers(sensor_family("flat_pad"))
    with live_page("Design", options) as server:
        page = DesignPage(server, answers, {}, out)
        try:
            yield server, page
        finally:
            page.work.close()
            answers.close()


@pytest.fixture
def formulas_alone(monkeypatch):
    """Designs are answered by what needs neither solid, press nor drawing."""
    answer = DesignAnswers.answer
    monkeypatch.setattr(DesignAnswers, "_begin_exact", lambda *_: None)

    def begun(self, choice, told, superseded):
        return answer(self, choice, told, lambda: True)

    monkeypatch.setattr(DesignAnswers, "answer", begun)


@pytest.mark.thorough
@pytest.mark.usefixtures("formulas_alone")
def test_sliders_of_the_design_page_change_its_numbers(tmp_path):
    with design_page(tmp_path / "out") as (server, page_of):
        with chromium_page(page_address(server)) as page:
            row = page.get_by_role("row").filter(has_text="formula")
            row.wait_for()
            before = row.inner_text()

            def fill(label, value):
                place = page.get_by_text(label, exact=True).first
                box = place.locator("xpath=ancestor::div[.//input][1]//input[@type='text']").first
                box.fill(value)
                box.press("Enter")

            fill("Young's modulus [MPa]", "1.0")
            wait_for(page, lambda: row.inner_text() != before)
            assert page_of.controls.overrides() == {"young_modulus_mpa": 1.0}
            # What the family refuses stands beside the slider, in its words: two stiffnesses.
            fill("Shore A", "20")
            page.get_by_text("the gel has one stiffness").first.wait_for()
            page.get_by_text("Reset", exact=True).click()
            wait_for(page, lambda: page_of.controls.overrides() == {})
            wait_for(page, lambda: row.inner_text().split()[1] == before.split()[1])
            # Undo brings the two stiffnesses back, then the one alone; redo goes forth again.
            both = {"young_modulus_mpa", "shore_a"}
            for button, known in (("Undo", both), ("Undo", {"young_modulus_mpa"}), ("Redo", both)):
                page.get_by_text(button, exact=True).click()
                wait_for(page, lambda known=known: {*page_of.controls.overrides()} == known)
            assert page_of.controls.overrides()["young_modulus_mpa"] == 1.0
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_of_many_changes_the_last_is_shown_while_files_are_written_and_closing_ends_all(tmp_path):
    out = tmp_path / "out"
    with design_page(out) as (_, page):
        for thickness in np.linspace(2.0, 5.0, 16):
            page.controls.set("thickness_mm", float(thickness))
        # An export takes what the sliders say, also amid the work on it.
        exported = threading.Thread(target=page.export, args=("drawing",))
        exported.start()
        assert page.work.wait(120)
        exported.join(120)
        assert (out / "drawing" / "drawing.pdf").stat().st_size > 0
        assert "drawing.pdf" in page._exported.content
        shown = page.shown
        assert shown is not None and shown.missing == [] and shown.failed == {}
        assert shown.parameters.values()["thickness_mm"] == 5.0
        assert shown.exact is not None
        assert f"| default | {shown.exact.force_n:.4g} N" in page._force.content
        assert page._status.content.startswith("**Done**")
        # A design that is refused is told in words, and the next one is answered.
        page.controls.set("shore_a", 20.0)
        page.controls.set("shore_00", 20.0)
        assert page.work.wait(60)
        assert "**Rejected:**" in page._status.content
        page.go("Reset")
        page.controls.set("thickness_mm", 4.5)
        limit = time.monotonic() + 60
        while page.shown is None or page.shown is shown or "solid" in page.shown.missing:
            assert time.monotonic() < limit
            time.sleep(0.01)
        # Closed amid the answer: what is under way ends.
    assert page.work.wait(0)
    assert page.shown is not None and "exact" in page.shown.missing


@pytest.mark.thorough
@pytest.mark.usefixtures("formulas_alone")
def test_a_fault_of_the_program_is_told_and_the_page_lives_on(tmp_path, monkeypatch, capsys):
    with design_page(tmp_path / "out") as (_, page):
        answer = page._answers.answer
        monkeypatch.setattr(page._answers, "answer", lambda *_: 1 // 0)
        page.controls.set("thickness_mm", 4.0)
        assert page.work.wait(60)
        assert "ZeroDivisionError" in page._status.content
        assert "ZeroDivisionError" in capsys.readouterr().err
        monkeypatch.setattr(page._answers, "answer", answer)
        page.controls.set("thickness_mm", 4.1)
        assert page.work.wait(60)
        assert page.shown is not None and page.shown.parameters.values()["thickness_mm"] == 4.1
        assert "ZeroDivisionError" not in page._status.content


@pytest.mark.slow
def test_a_dark_design_page_enlarges_its_drawing_and_writes_files(tmp_path):
    out = tmp_path / "out"
    with design_page(out, replace(HERE, dark=True)) as (server, page_of):
        with chromium_page(page_address(server), (1400, 800)) as page:
            page.get_by_role("tab", name="Drawing").click()
            enlarge = page.get_by_role("button", name="Enlarge")
            wait_for(page, lambda: page_of.shown and page_of.shown.drawing_rgb is not None, 60)
            other = page.context.browser.new_page()
            other.goto(page_address(server))
            other.get_by_text("Press of a ball").wait_for()
            enlarge.click()
            sheet = page.get_by_role("dialog").locator("img")
            # Larger than in the panel, and whole: its button below is on the page.
            wait_for(page, lambda: sheet.bounding_box()["width"] > 600)
            # Another browser is left alone.
            assert other.get_by_role("dialog").count() == 0
            other.close()
            close = page.get_by_role("dialog").get_by_role("button", name="Close").last
            box = close.bounding_box()
            assert box["y"] + box["height"] < 800
            close.click()
            page.get_by_role("tab", name="Export").click()
            for kind, file in (
                ("STEP, STL, 3MF, DXF", "pad/pad.step"),
                ("drawing", "drawing/drawing.pdf"),
                ("profile and mesh", "profile/pad.vtu"),
                ("parameters (TOML)", "parameters/design.toml"),
            ):
                page.get_by_role("button", name=kind, exact=True).click()
                page.get_by_text(file, exact=True).wait_for(timeout=60_000)
                assert (out / file).stat().st_size > 0
            with page.expect_download(timeout=60_000) as sent:
                page.get_by_role("button", name="Download what was written").click()
            assert sent.value.suggested_filename == "design.toml"
            content = Path(sent.value.path()).read_bytes()
            assert content == (out / "parameters" / "design.toml").read_bytes()
            assert np.median(picture(page)) < 64


@pytest.mark.slow
@pytest.mark.parametrize("words", ["view ball-rolling", "design gelsight --page --out {}/made"])
def test_ctrl_c_closes_a_page_with_exit_code_130(tmp_path, words):
    words = f"{words.format(tmp_path)} --no-browser --port 0"
    command = [sys.executable, "-m", "taccel_lab.cli.app", *words.split()]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        while line and "http://127.0.0.1:" not in line:
            line = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
        assert "Traceback" not in process.stderr.read()
    assert not list(tmp_path.iterdir())


@pytest.mark.thorough
def test_values_of_each_led_and_camera_are_written_with_commas():
    given = {"led_tilt_deg": (40.0, 80.0), "thickness_mm": 5.0}
    with live_page("Design", HERE) as server:
        controls = DesignControls(server, sensor_family("stereo_pad"), given, lambda _: None)
        assert controls.overrides() == given
        controls.set("camera_x_mm", "-6, 6")
        assert controls.overrides() == {**given, "camera_x_mm": (-6.0, 6.0)}
        controls.set("led_tilt_deg", "55")
        assert controls.overrides()["led_tilt_deg"] == 55.0
        controls.set_all({"camera_x_mm": (-5.0, 5.0)})
        assert controls.overrides() == {"camera_x_mm": (-5.0, 5.0)}
        controls.set_all({})
        assert controls.overrides() == {}
