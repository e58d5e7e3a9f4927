# SPDX-License-Identifier: Apache-2.0
"""Labels are clicked: circles through places on the rim, kept beside those that were there."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle, load_captures
from taccel_lab.calibration.capture.contacts_file import with_contact
from taccel_lab.calibration.record.label_page import LabelPage, sheet_of
from taccel_lab.calibration.record.labelling import Labelling
from taccel_lab.errors import InputError
from taccel_lab.report.live_page import PageOptions, live_page, page_address
from tests.support.small_captures import CIRCLES, GRID, write_captures
from tests.viewer.browser import chromium_page, picture, wait_for

WANTED = ContactCircle(34.0, 31.0, 12.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "set")


def labelling(folder: Path) -> Labelling:
    times = iter(range(100))
    found = Labelling.of(folder)
    found.now = lambda: f"time {next(times)}"
    return found


def on_rim(circle: ContactCircle, degrees: float) -> tuple[float, float]:
    angle = np.radians(degrees)
    u = circle.u_px + circle.radius_px * np.cos(angle)
    rows = circle.radius_px * GRID.mm_per_px_x / GRID.mm_per_px_y
    return float(u), float(circle.v_px + rows * np.sin(angle))


def click(on: Labelling, circle: ContactCircle, *degrees: float) -> None:
    for angle in degrees:
        on.click(*on_rim(circle, angle))


def circles(folder: Path) -> dict[str, ContactCircle | None]:
    return {press.name: press.circle for press in load_captures(folder).presses}


@pytest.mark.parametrize("degrees", [(0, 120, 240), (10, 40, 100, 200), (180, 190, 200, 350)])
def test_places_on_a_rim_become_the_circle(folder: Path, degrees: tuple[float, ...]) -> None:
    before = (folder / "captures.toml").read_bytes()
    page = labelling(folder)
    assert page.shown().origin == "label" and page.shown().circle == CIRCLES[0]
    click(page, WANTED, *degrees)
    page.save()
    assert page.shown().origin == "clicked" and not page.clicks
    kept = circles(folder)
    assert vars(kept["p0"]) == pytest.approx(vars(WANTED), abs=0.01)  # type: ignore[arg-type]
    assert kept["p1"] == CIRCLES[1]
    assert (folder / "captures.toml").read_bytes() == before


def test_nothing_that_was_said_is_lost(folder: Path) -> None:
    """A press is clicked twice and left out, in a file with a hand's own lines."""
    path = folder / "contacts.toml"
    path.write_text(
        '# by Ana\n[[contact]]  # worn\npress = "p1"\nskip = true\n\n'
        '[[contact]]\npress = "p0"\nu_px = 30.5\nv_px = 30.0\nradius_px = 9.0\n# the\u2028end'
    )
    page = labelling(folder)
    assert page.shown().circle == ContactCircle(30.5, 30.0, 9.0)
    click(page, WANTED, 0, 90, 180)
    page.save()
    page.leave_out()
    assert page.shown().origin == "left out"
    text = path.read_text()
    for line in ("# by Ana", "[[contact]]  # worn", "# until time 0: radius_px = 9.0",
                 "# the\u2028end", "# until time 1: radius_px = 12.0"):  # fmt: skip
        assert line in text.split("\n"), text
    said = {entry["press"]: entry for entry in tomllib.loads(text)["contact"]}
    assert said == {"p0": {"press": "p0", "skip": True}, "p1": {"press": "p1", "skip": True}}
    # A circle brings a press back.
    page.go(1)
    click(page, CIRCLES[1], 0, 90, 180)
    page.save()
    assert set(circles(folder)) == {"p1", "p2", "p3", "p4"}


def test_what_makes_no_circle_is_not_saved(folder: Path) -> None:
    page = labelling(folder)
    for clicked, words in (
        ([], "0 places are clicked; at least 3"),
        ([(10, 10), (20, 20)], "2 places"),
        ([(10, 10), (20, 20), (30, 30)], "3 places .*line"),
        ([(20, 20), (21, 20), (20.5, 21)], "too small"),
        ([on_rim(ContactCircle(47, 36, 30), a) for a in (0, 120, 240)], "more than the ball"),
        ([(200, 10), (-5, 3), (10, 500)], "0 places"),
    ):
        page.go(0)
        for place in clicked:
            page.click(*place)
        with pytest.raises(InputError, match=words):
            page.save()
    assert not (folder / "contacts.toml").exists()
    for number in range(5):
        page.go(number)
        if number < 4:
            page.leave_out()
    before = (folder / "contacts.toml").read_text()
    with pytest.raises(InputError, match="leaves out every press"):
        page.leave_out()
    assert (folder / "contacts.toml").read_text() == before


def test_folders_without_anything_to_label_are_refused(folder: Path, tmp_path: Path) -> None:
    (folder / "contacts.toml").write_text('[[contact]]\npress = "nobody"\nskip = true\n')
    with pytest.raises(InputError, match="names nobody"):
        Labelling.of(folder)
    with pytest.raises(InputError, match="does not exist"):
        Labelling.of(tmp_path / "no")
    (folder / "contacts.toml").unlink()
    text = (folder / "captures.toml").read_text()
    (folder / "captures.toml").write_text(text.split("[[presses]]")[0])
    with pytest.raises(InputError, match="holds no ball presses"):
        Labelling.of(folder)


def test_a_name_with_odd_characters_survives() -> None:
    odd = 'a "b" \\ ü#[]'
    text = with_contact("", [], odd, WANTED, "now")
    again = with_contact(text, [odd], odd, None, "later")
    assert tomllib.loads(again)["contact"] == [{"press": odd, "skip": True}]
    assert all(f"# until later: {line}" in again for line in text.splitlines()[1:])


def test_entries_of_a_list_are_not_overwritten(folder: Path) -> None:
    text = 'contact = [{ press = "p0", skip = true }]\n'
    (folder / "contacts.toml").write_text(text)
    page = labelling(folder)
    page.go(1)
    with pytest.raises(InputError, match=r"write each as \[\[contact\]\]"):
        page.leave_out()
    assert (folder / "contacts.toml").read_text() == text


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
def test_places_of_a_sheet_are_pixels(folder: Path, aspect: float) -> None:
    page = labelling(folder)
    shown = page.shown()
    sheet = sheet_of(shown.press.image(), aspect, page, shown)
    for place in ((0.0, 0.0), (GRID.width_px - 1.0, 3.0), (30.25, 71.0)):
        across, down = sheet.place(*place)
        assert 0 < across < 1 and 0 < down < 1
        assert sheet.pixel(across, down) == pytest.approx(place)


def test_a_circle_is_drawn_on_oblong_pixels_as_the_oval_that_it_is(folder: Path) -> None:
    page = labelling(folder)
    shown = page.shown()
    picture = sheet_of(np.full((72, 96, 3), 128, np.uint8), 1.0, page, shown).picture
    blue = (picture[..., 2].astype(int) - picture[..., 0] > 60).nonzero()
    high, wide = (np.ptp(where) for where in blue)
    assert high / wide == pytest.approx(GRID.mm_per_px_x / GRID.mm_per_px_y, rel=0.03)


@pytest.mark.thorough
def test_clicks_in_the_browser_become_a_label(folder: Path) -> None:
    pytest.importorskip("viser", reason="the extra view is not installed")
    on = labelling(folder)
    with live_page("Labels", PageOptions(port=0, browser=False)) as server:
        page_of = LabelPage(server, on)
        with chromium_page(page_address(server), (1280, 800)) as page:
            page.wait_for_selector("text=Click 3 places", timeout=60_000)
            canvas: Any = page.locator("canvas").first
            wait_for(page, lambda: drawn(page), 60)
            box = canvas.bounding_box()
            for degrees in (20, 140, 260):
                across, down = page_of.place(*on_rim(WANTED, degrees))
                page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
                page.wait_for_timeout(300)
            page.wait_for_selector("text=Save the red circle, or", timeout=60_000)
            page.get_by_role("button", name="Save circle").click()
            page.wait_for_selector("text=Saved: centre", timeout=60_000)
            page.get_by_text("Next", exact=True).click()
            page.wait_for_selector("text=p1: 2 of 5", timeout=60_000)
            page.get_by_role("button", name="Done").click()
            wait_for(page, page_of.done.is_set, 60)
    assert list(on.saved) == ["p0"]
    assert vars(circles(folder)["p0"]) == pytest.approx(vars(WANTED), abs=0.5)  # type: ignore[arg-type]


def drawn(page: Any) -> bool:
    """Whether a picture has come: something blue on it."""
    seen = picture(page)[:, :800].astype(int)
    return bool((seen[..., 2] - seen[..., 0] > 90).sum() > 50)
