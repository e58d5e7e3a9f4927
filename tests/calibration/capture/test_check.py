# SPDX-License-Identifier: Apache-2.0
"""Faults put into made-up captures, one at a time: each is found, and nothing else is claimed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture import ContactCircle, load_capture_folder
from taccel_lab.calibration.capture.sensor_facts import catalogue_view_mm
from taccel_lab.calibration.check import CaptureCheck, check_captures, check_page
from taccel_lab.calibration.check.balls import check_balls
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.signals.frame_operators import lost_rows
from tests.calibration.drawn.faults import blur, drift
from tests.support.capture_sets import (
    BALL_MM,
    HEIGHT,
    WIDTH,
    CaptureMaker,
    gel,
    press,
    spread_circles,
)
from tests.support.commands import run
from tests.support.synthetic_presses import GRID

FEW, SOME = spread_circles(4), spread_circles(8)
"""Fewer presses where a fault changes all of them, or some; the first of the sound ones."""
SLOPED = np.linspace(-1, 1, HEIGHT)[:, None, None]
ERROR, WARNING = Severity.ERROR, Severity.WARNING
MINI = "gelsight_mini"
Make = Callable[[], CaptureMaker]
Change = Callable[[np.ndarray], np.ndarray]
BGR: Change = lambda image: image[..., ::-1]  # noqa: E731


def check(maker: CaptureMaker, folder: Path) -> CaptureCheck:
    return check_captures(maker.load(folder), fit_ball=False)


def by_code(found: CaptureCheck) -> dict[str, Remark]:
    return {finding.code: finding for finding in found.findings}


def states(found: CaptureCheck) -> dict[str, str]:
    return {block.command: str(block.readiness) for block in found.blocks}


def all_are_found(found: CaptureCheck) -> bool:
    return all(frame.contact is not None for frame in found.frames)


def few(circles: list[ContactCircle] = FEW, **changes: Any) -> CaptureMaker:
    return CaptureMaker(circles=list(circles), **changes)


def spoilt(
    which: Iterable[int], how: Change, circles: list[ContactCircle] = SOME, **changes: Any
) -> CaptureMaker:
    """Captures with some images changed."""
    maker = few(circles, **changes)
    maker.change(list(which), how)
    return maker


def off(
    maker: CaptureMaker, which: Iterable[int] | None = None, u_px: float = 9.0, v_px: float = 0.0
) -> CaptureMaker:
    """Captures with some labels, or all, moved."""
    for i in range(len(maker.labels)) if which is None else which:
        label = maker.labels[i]
        maker.labels[i] = replace(label, u_px=label.u_px + u_px, v_px=label.v_px + v_px)
    return maker


def of_balls(which: Iterable[int], ball_mm: float, stated_mm: float | None = None) -> CaptureMaker:
    """Captures with some presses of another ball, which the manifest may state."""
    maker = few(spread_circles(7), labelled=False)
    for i in which:
        maker.images[i] = press(maker.circles[i], ball_mm)
        maker.extra[i] = f"radius_mm = {stated_mm}" if stated_mm else ""
    return maker


def at_one_spot() -> list[ContactCircle]:
    rng = np.random.default_rng(2)
    return [ContactCircle(80 + rng.uniform(-4, 4), 60 + rng.uniform(-4, 4), rng.uniform(9, 15))
            for _ in range(6)]  # fmt: skip


def test_sound_captures_get_no_remark_and_figures_of_every_press(tmp_path: Path) -> None:
    sound = check(CaptureMaker(), tmp_path)
    assert set(by_code(sound)) <= {"too_few"} and sound.usable and all_are_found(sound)
    state = states(sound)
    assert state["color"] == state["normals"] == "ready"
    assert state["camera"] == state["markers"] == state["material"] == "absent"
    figures = sound.figures()
    assert [row["name"] for row in figures["presses"]] == [f"p{i:02d}" for i in range(15)]
    assert max(row["label_center_px"] for row in figures["presses"]) < 2.5
    assert 0.5 < figures["coverage"]["share"] < 1
    assert [p.name for p in check_page(sound).pictures] == ["coverage", "frames", "light"]


FAULTS: dict[str, tuple[Make, str, str]] = {
    # What is spoilt; the finding's code, severity and frames (if it has any); words of it.
    "auto white balance": (lambda: spoilt((0, 2), lambda i: drift(i, [1.08, 1.0, 0.93]), FEW),
                           "light_drifts warning", ""),
    "saturation": (lambda: spoilt(range(4), lambda i: i + 90, FEW, background=gel() + 90),
                   "saturated warning", "Lower the exposure"),
    "blue for red": (
        lambda: spoilt([3, 7], lambda i: i[..., [2, 1, 0]]), "channels_swapped error p03 p07", ""),
    "channels turned": (
        lambda: spoilt([3, 7], lambda i: i[..., [1, 2, 0]]), "channels_swapped error p03 p07", ""),
    "blue for red in the background": (lambda: few(background=BGR(gel())),
        "channels_swapped error", "4 of 4 presses and the background.*BGR"),
    # The made-up lamps stand red, green, blue clockwise, as a GelSight Mini's do.
    "blue for red everywhere": (
        lambda: spoilt(range(4), BGR, FEW, background=BGR(gel()), sensor=MINI),
        "lamps_reversed warning", ""),
    "mixed sensors": (
        lambda: spoilt([1, 5], lambda i: i - gel() + np.flip(gel(), 1) + 40 * SLOPED),
        "mixed_sensors error p01 p05", ""),
    "blur": (lambda: spoilt([6], lambda i: blur(i, 5.0)), "blurred warning p06", ""),
    "one spot": (lambda: few(at_one_spot()), "one_spot error", ""),
    "empty parts": (lambda: few([c for c in spread_circles(20) if c.u_px < 85]),
                    "coverage warning", "top right.*bottom right"),
    "background of another sensor": (
        lambda: few(background=np.flip(gel(), 1) + 60 * SLOPED), "background_differs error", ""),
    "ball smaller than its contacts": (
        lambda: few(radius_mm=1.0, labelled=False), "ball_too_small error", "the ball 1 mm"),
    "wrong ratio of two balls": (
        lambda: of_balls(range(4), 4.0, 1.6), "ball_contradicted error", ""),
    # 25.3 x 19.0 mm of a pad of 25.25 x 20.75 mm.
    "view up to the pad's edge": (
        lambda: few(sensor=MINI, mm_per_px=0.1585), "pad_edge warning", ""),
    "view past the pad": (
        lambda: few(sensor=MINI, mm_per_px=0.25, radius_mm=5.0), "scale_past_pad error", ""),
    "unknown sensor": (lambda: CaptureMaker(sensor="gelsite"), "sensor_unknown error", ""),
    "two labels": (lambda: off(few(SOME), (2, 6), 9, 2), "labels_off warning p02 p06", ""),
    "most labels": (lambda: off(few(), [i for i, c in enumerate(FEW) if c.u_px < 130]),
                    "labels_off error", "--circles detected"),
    "a label outside the image": (lambda: off(few(), [2], 10 * WIDTH), "labels_off error p02", ""),
    "a pressed background": (
        lambda: few(SOME, background=press(ContactCircle(100.0, 70.0, 16.0))),
        "background_pressed error", r"\(100, 7"),
}  # fmt: skip


@pytest.mark.thorough(cases=(
    "blue for red", "blue for red in the background", "channels turned", "empty parts",
    "mixed sensors", "one spot", "unknown sensor", "wrong ratio of two balls", "two labels",
    "most labels", "a pressed background",
))  # fmt: skip
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_by_its_name(tmp_path: Path, fault: str) -> None:
    maker, said, words = FAULTS[fault]
    code, severity, *frames = said.split()
    found = check(maker(), tmp_path)
    (finding,) = (finding for finding in found.findings if finding.code == code)
    assert finding.severity == severity and not (severity == "error" and found.usable)
    assert re.search(words, finding.message), finding.message
    assert not frames or list(finding.frames) == frames
    assert code != "light_drifts" or "color" in finding.blocks


@pytest.mark.thorough(cases=("one place",))
@pytest.mark.parametrize(("maker", "code"), [
    (lambda: spoilt([1, 5], lambda image: image[::-1, ::-1]), "channels_swapped"),
    (lambda: few(sensor=MINI), "lamps_reversed"),
    (lambda: of_balls(range(4), 4.0, 4.0), "ball_contradicted"),
    (lambda: few(sensor=MINI, mm_per_px=0.1585), "scale_past_pad"),
    # All presses at one place have one median, too, and yet the gel was untouched.
    (lambda: few([ContactCircle(80.0, 60.0, 15.0)] * 8), "background_pressed"),
], ids=["turned", "lamps", "balls", "view", "one place"])  # fmt: skip
def test_what_is_none_of_these_faults(tmp_path: Path, maker: Make, code: str) -> None:
    assert code not in by_code(check(maker(), tmp_path))


def test_duplicates(tmp_path: Path) -> None:
    circles = list(SOME)
    circles[4], circles[5] = circles[2], circles[2]
    folder = few(circles).write(tmp_path)
    (folder / "p04.png").write_bytes((folder / "p02.png").read_bytes())
    found = by_code(check_captures(load_capture_folder(folder), fit_ball=False))["duplicates"]
    # p05 shows the same press with other noise.
    assert found.frames == ("p02", "p04", "p05")
    assert set(found.blocks) == {"color", "normals", "depth"}


@pytest.mark.thorough
def test_images_reject_single_labels_and_no_shift_that_all_share(tmp_path: Path) -> None:
    maker = off(off(few(SOME)), [2], -24)
    maker.change([5], lambda _: gel())
    found = check(maker, tmp_path)
    assert len(by_code(found)["labels_off"].frames) > 4
    assert found.rejected_labels == {"p02", "p05"}


def test_labels_of_images_of_another_size_are_told_so(tmp_path: Path) -> None:
    maker = few()
    maker.labels = [ContactCircle(c.u_px / 2, c.v_px / 2, c.radius_px / 2) for c in FEW]
    halved = by_code(check(maker, tmp_path / "half"))["labels_off"]
    assert f"divided by 0.50: were they made in images of {WIDTH // 2}x" in halved.message
    moved = by_code(check(off(few()), tmp_path / "moved"))["labels_off"]
    assert "divided by" not in moved.message


@pytest.mark.thorough
def test_labels_that_the_border_cuts_are_used_and_those_outside_are_told(tmp_path: Path) -> None:
    maker = few([ContactCircle(WIDTH - 6.0, 60.0, 15.0), *spread_circles(3)])
    assert not {"no_contact", "labels_off"} & set(by_code(check(maker, tmp_path / "cut")))
    maker.labels[1] = ContactCircle(-4.0, 50.0, 20.0)
    maker.labels[2] = ContactCircle(WIDTH + 90.0, 50.0, 20.0)
    outside = check(maker, tmp_path / "outside").findings
    (impossible,) = [found for found in outside if "of no press" in found.message]
    assert impossible.code == "labels_off" and "reaches into the image" in impossible.message
    assert impossible.severity == ERROR and impossible.frames == ("p01", "p02")


def crop_and_enlarge(image: np.ndarray, left: int, top: int, wide: int, high: int) -> np.ndarray:
    part = np.ascontiguousarray(image[top : top + high, left : left + wide])
    return cv2.resize(part, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)


@pytest.mark.thorough(cases=("framing",))
@pytest.mark.parametrize("background", ["black", "framing", "none"])
def test_the_median_stands_in_for_a_background(tmp_path: Path, background: str) -> None:
    framed = {"background": crop_and_enlarge(gel(), 20, 15, 120, 90), "circles": SOME}
    black = {"background": np.zeros((HEIGHT, WIDTH, 3))}
    folder = few(**{"black": black, "framing": framed, "none": {}}[background]).write(tmp_path)
    if background == "none":
        text = (folder / "captures.toml").read_text()
        cut = text.replace('background = "background.png"\n', "")
        (folder / "captures.toml").write_text(cut)
    found = check_captures(load_capture_folder(folder), fit_ball=False)
    assert all_are_found(found)
    if background == "none":
        assert "no_background" in by_code(found)
    else:
        said = by_code(found)["background_differs"].message
        assert not found.usable and (background == "black" or "--background median" in said)
        assert states(found)["background"] == states(found)["color"] == "blocked"


def grey(image: np.ndarray) -> np.ndarray:
    return np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2)


def darkened() -> CaptureMaker:
    """As a DIGIT that is pressed so that all three lamps lose alike."""
    maker = few(spread_circles(3), sensor=MINI)
    for i, circle in enumerate(maker.circles):
        dome = np.clip(1 - (circle.distance_px(GRID) / circle.radius_px) ** 2, 0, None)
        maker.images[i] = gel() - 50 * dome[..., None]
    return maker


def with_bar() -> CaptureMaker:
    bar = np.zeros((HEIGHT, WIDTH, 1))
    bar[:, 70:90] = -60.0
    return spoilt(range(4), lambda _: gel() + bar, FEW, labelled=False, sensor=MINI)


@pytest.mark.thorough(cases=("grey", "darkened", "bar"))
@pytest.mark.parametrize(("maker", "block", "state", "missing", "codes"), [
    (lambda: spoilt(range(4), grey, FEW, background=grey(gel()), labelled=False), "color",
     "absent", "coloured lamps: this sensor, or these images, are grey$", set()),
    # Colours of the pictures speak where contacts have none, or there are none.
    (darkened, "color", None, "(?!.*coloured)", set()),
    (with_bar, "color", "blocked", "(?!.*coloured)", set()),
    (lambda: few(mm_per_px=None), "background", "blocked",
     rf"the scale \(these images are {WIDTH}x{HEIGHT} px", set()),
    (lambda: few(radius_mm=None, mm_per_px=None), "color", "blocked",
     "the ball's radius, the scale$", {"ball_radius_unstated", "scale_unstated"}),
    (FAULTS["view past the pad"][0], "color", "blocked", "", {"scale_past_pad"}),
    (FAULTS["view past the pad"][0], "normals", "blocked", "", {"scale_past_pad"}),
], ids=["grey", "darkened", "bar", "size", "unstated", "past", "past too"])  # fmt: skip
def test_what_a_block_lacks(
    tmp_path: Path, maker: Make, block: str, state: str | None, missing: str, codes: set[str]
) -> None:
    found = check(maker(), tmp_path)
    (status,) = [status for status in found.blocks if status.command == block]
    assert re.match(missing, status.missing) and codes <= set(by_code(found))
    assert state is None or status.readiness == state
    if maker in (darkened, with_bar):
        assert "grey_or_colour" not in by_code(found)


def test_frames_that_are_not_whole_are_named_and_left_out(tmp_path: Path) -> None:
    maker = few(spread_circles(7), labelled=False)
    maker.change([2], lambda image: lost_rows(image.astype(np.uint8), HEIGHT // 2))
    found = check(maker, tmp_path)
    finding = by_code(found)["not_whole"]
    assert finding.severity == WARNING and finding.frames == ("p02",)
    assert f"rows {HEIGHT // 2} to {HEIGHT - 1} are of one colour" in finding.message
    assert "no_contact" not in by_code(found) and set(finding.blocks) >= {"color", "normals"}


@pytest.mark.thorough
def test_frame_without_contact(tmp_path: Path) -> None:
    maker = few(spread_circles(11), labelled=False)
    for which, severity, frames in (([8], WARNING, ("p08",)), ([1, 3, 5, 7, 9], ERROR, None)):
        maker.change(which, lambda _: gel())
        found = check(maker, tmp_path / severity)
        finding = by_code(found)["no_contact"]
        assert finding.severity == severity and found.usable == (severity == WARNING)
        assert frames is None or finding.frames == frames


@pytest.mark.parametrize(("radius_px", "told"), [(20.1, False), (22.0, False), (26.0, True)])
def test_a_contact_a_little_wider_than_its_ball_is_an_error_of_circles(
    tmp_path: Path, radius_px: float, told: bool
) -> None:
    """Of a ball of 2 mm, which ends at 20 px: a contact of 2.01 mm is one that is pressed deep."""
    frames, circle = check(few(), tmp_path).frames, replace(FEW[0], radius_px=radius_px)
    wide = [replace(f, contact=None, press=replace(f.press, circle=circle)) for f in frames]
    found = check_balls(wide, PixelGrid(WIDTH, HEIGHT, 0.1, 0.1), 2.0, None)
    assert ("ball_too_small" in {finding.code for finding in found}) == told


def with_travel(maker: CaptureMaker) -> CaptureMaker:
    """Between those of an elastic gel (a^2 = R d) and of one that does not rise (2 R d)."""
    depths = [(0.1 * c.radius_px) ** 2 / (1.4 * 2.0) for c in maker.circles]
    maker.extra = [f"depth_mm = {depth:.4f}" for depth in depths]
    return maker


@pytest.mark.parametrize(
    ("stated", "wrong", "doubled"),
    [(2.0, False, False), (4.0, True, True), (0.8, True, False), (12.0, True, False)],
)
def test_ball_against_travel(tmp_path: Path, stated: float, wrong: bool, doubled: bool) -> None:
    """A diameter is only asked about where it would explain the travel."""
    circles = [replace(c, radius_px=c.radius_px - 6) for c in FEW]
    codes = by_code(check(with_travel(few(circles, radius_mm=stated, labelled=False)), tmp_path))
    assert ("ball_contradicted" in codes) == wrong
    if wrong:
        message = codes["ball_contradicted"].message
        assert f"stated is {stated:g} mm" in message and ("diameter" in message) == doubled


@pytest.mark.thorough
@pytest.mark.parametrize("stated", [2.0, 1.55])
def test_ball_against_slopes(tmp_path: Path, stated: float) -> None:
    found = check_captures(few(spread_circles(6), radius_mm=stated, labelled=False).load(tmp_path))
    assert ("wrong_ball_radius" in by_code(found)) == (stated < 2.0)
    assert found.usable == ("ball_from_below" in by_code(found)) == (stated == 2.0)


@pytest.mark.thorough
@pytest.mark.parametrize("odd", [{"radius_px": 1.06}, {"u_px": 40.0}], ids=["wide", "outside"])
def test_odd_labels_do_not_stop_the_check_of_the_ball(
    tmp_path: Path, odd: dict[str, float], capsys: pytest.CaptureFixture[str]
) -> None:
    """Wider than the ball by what contacts are unsure by, or beside the image."""
    maker = few(spread_circles(5))
    if "radius_px" in odd:
        odd = {"radius_px": odd["radius_px"] * BALL_MM / GRID.mm_per_px_x}
    else:
        odd = {"u_px": WIDTH + odd["u_px"]}
    maker.labels[0] = replace(maker.labels[0], **odd)
    folder = maker.write(tmp_path)
    assert run("capture", "check", folder) in (0, 1)
    assert "ball" in capsys.readouterr().out


@pytest.mark.thorough
def test_a_larger_ball_is_said_to_fit_where_no_travel_tells(tmp_path: Path) -> None:
    """A diameter that is typed for the radius: colours fit it as well, and nobody is asked."""
    maker = few(spread_circles(6), radius_mm=4.0, labelled=False)
    found = by_code(check_captures(maker.load(tmp_path / "none")))
    assert found["ball_from_below"].severity == Severity.INFO
    message = found["ball_from_below"].message
    assert "8.8 mm would leave" in message and "no +- holds another" in message
    assert "diameter" not in message
    told = by_code(check_captures(with_travel(maker).load(tmp_path / "travel")))
    assert "ball_contradicted" in told and "ball_from_below" not in told


def test_a_scale_ten_times_off_is_named(tmp_path: Path) -> None:
    """Of a sensor that is in no catalogue: 160 mm of gel, and contacts wider than the ball."""
    folder = few(mm_per_px=1.0, radius_mm=12.4).load(tmp_path)
    found = by_code(check_captures(folder, fit_ball=False))
    shown = "at 1 x 1 mm/px the image shows 160.0 x 120.0 mm, more than the pad"
    assert shown in found["scale_past_pad"].message
    assert "at 1 mm/px, the ball 12.4 mm" in found["ball_too_small"].message
    with pytest.raises(InputError, match=rf"{shown}.*check the scale"):
        base_profile(None, folder)


@pytest.mark.parametrize(("mm_per_px", "told"), [(0.05, True), (0.1, False), (0.25, False)])
def test_a_view_that_no_sensor_has(tmp_path: Path, mm_per_px: float, told: bool) -> None:
    """8 mm; the catalogue's sensors show 17 to 44."""
    found = by_code(check(few(mm_per_px=mm_per_px, radius_mm=5.0), tmp_path))
    assert ("scale_unusual" in found) == told
    low, high = catalogue_view_mm()
    assert 10 < low < 17 and 44 < high < 60
