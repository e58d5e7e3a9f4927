# SPDX-License-Identifier: Apache-2.0
"""Faults put into made-up captures, one at a time: each is found, and nothing else is claimed."""

from __future__ import annotations

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
from tests.calibration.drawn.faults import blur, drift
from tests.support.capture_sets import HEIGHT, WIDTH, CaptureMaker, gel, press, spread_circles
from tests.support.synthetic_presses import GRID


def check(maker: CaptureMaker, folder: Path) -> CaptureCheck:
    return check_captures(maker.load(folder), fit_ball=False)


def by_code(found: CaptureCheck) -> dict[str, Remark]:
    return {finding.code: finding for finding in found.findings}


HARMLESS = {"too_few"}

FEW, SOME = spread_circles(4), spread_circles(8)
"""Fewer presses where a fault changes all of them, or some; the first of the sound ones."""


def few(**changes: Any) -> CaptureMaker:
    return CaptureMaker(circles=list(FEW), **changes)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> CaptureCheck:
    return check(CaptureMaker(), tmp_path_factory.mktemp("sound"))


@pytest.mark.thorough
def test_sound_captures_get_no_remark(sound: CaptureCheck) -> None:
    assert set(by_code(sound)) <= HARMLESS
    assert sound.usable
    state = {block.command: str(block.readiness) for block in sound.blocks}
    assert state["color"] == "ready" and state["normals"] == "ready"
    assert state["camera"] == state["markers"] == state["material"] == "absent"
    assert all(frame.contact is not None for frame in sound.frames)


def test_figures_are_of_every_press(sound: CaptureCheck) -> None:
    figures = sound.figures()
    assert [row["name"] for row in figures["presses"]] == [f"p{i:02d}" for i in range(15)]
    assert max(row["label_center_px"] for row in figures["presses"]) < 2.5
    assert 0.5 < figures["coverage"]["share"] < 1
    page = check_page(sound)
    assert [picture.name for picture in page.pictures] == ["coverage", "frames", "light"]


Change = Callable[[np.ndarray], np.ndarray]


def spoilt(which: Iterable[int], how: Change, **changes: Any) -> CaptureMaker:
    """Captures with some images changed."""
    maker = CaptureMaker(**changes)
    maker.change(list(which), how)
    return maker


def of_balls(which: Iterable[int], ball_mm: float, stated_mm: float | None = None) -> CaptureMaker:
    """Captures with some presses of another ball, which the manifest may state."""
    maker = CaptureMaker(labelled=False, circles=spread_circles(7))
    for i in which:
        maker.images[i] = press(maker.circles[i], ball_mm)
        maker.extra[i] = f"radius_mm = {stated_mm}" if stated_mm else ""
    return maker


def at_one_spot() -> list[ContactCircle]:
    rng = np.random.default_rng(2)
    return [
        ContactCircle(80 + rng.uniform(-4, 4), 60 + rng.uniform(-4, 4), rng.uniform(9, 15))
        for _ in range(6)
    ]


SLOPED = np.linspace(-1, 1, HEIGHT)[:, None, None]
ERROR, WARNING = Severity.ERROR, Severity.WARNING
Row = tuple[str, Callable[[], CaptureMaker], str, Severity, tuple[str, ...], tuple[str, ...]]
FAULTS: list[Row] = [
    # What is spoilt, how, the finding's code and severity, words of it, its frames (if it has any).
    ("auto white balance",
     lambda: spoilt(range(0, 4, 2), lambda image: drift(image, [1.08, 1.0, 0.93]),
                    circles=FEW),
     "light_drifts", WARNING, (), ()),
    ("saturation",
     lambda: spoilt(range(4), lambda image: image + 90, circles=FEW, background=gel() + 90),
     "saturated", WARNING, ("Lower the exposure",), ()),
    ("blue for red", lambda: spoilt([3, 7], lambda image: image[..., [2, 1, 0]], circles=SOME),
     "channels_swapped", ERROR, (), ("p03", "p07")),
    ("channels turned", lambda: spoilt([3, 7], lambda image: image[..., [1, 2, 0]], circles=SOME),
     "channels_swapped", ERROR, (), ("p03", "p07")),
    ("blue for red in the background",
     lambda: few(background=gel()[..., ::-1]),
     "channels_swapped", ERROR, ("4 of 4 presses and the background", "BGR"), ()),
    # The made-up lamps stand red, green, blue clockwise, as a GelSight Mini's do.
    ("blue for red everywhere",
     lambda: spoilt(range(4), lambda image: image[..., ::-1], circles=FEW,
                    background=gel()[..., ::-1], sensor="gelsight_mini"),
     "lamps_reversed", WARNING, (), ()),
    ("mixed sensors",
     lambda: spoilt([1, 5], lambda image: image - gel() + np.flip(gel(), 1) + 40 * SLOPED,
                    circles=SOME),
     "mixed_sensors", ERROR, (), ("p01", "p05")),
    ("blur", lambda: spoilt([6], lambda image: blur(image, 5.0), circles=SOME),
     "blurred", WARNING, (), ("p06",)),
    ("one spot", lambda: CaptureMaker(circles=at_one_spot()), "one_spot", ERROR, (), ()),
    ("empty parts",
     lambda: CaptureMaker(circles=[c for c in spread_circles(20) if c.u_px < 85]),
     "coverage", WARNING, ("top right", "bottom right"), ()),
    ("background of another sensor",
     lambda: few(background=np.flip(gel(), 1) + 60 * SLOPED),
     "background_differs", ERROR, (), ()),
    ("ball smaller than its contacts", lambda: few(radius_mm=1.0, labelled=False),
     "ball_too_small", ERROR, ("the ball 1 mm",), ()),
    ("wrong ratio of two balls", lambda: of_balls(range(4), 4.0, 1.6),
     "ball_contradicted", ERROR, (), ()),
    # 25.3 x 19.0 mm of a pad of 25.25 x 20.75 mm.
    ("view up to the pad's edge", lambda: few(sensor="gelsight_mini", mm_per_px=0.1585),
     "pad_edge", WARNING, (), ()),
    ("unknown sensor", lambda: CaptureMaker(sensor="gelsite"), "sensor_unknown", ERROR, (), ()),
]  # fmt: skip


@pytest.mark.thorough(cases=(
    "blue for red", "blue for red in the background", "channels turned", "empty parts",
    "mixed sensors", "one spot", "unknown sensor", "wrong ratio of two balls",
))  # fmt: skip
@pytest.mark.parametrize(
    ("maker", "code", "severity", "words", "frames"),
    [row[1:] for row in FAULTS],
    ids=[row[0] for row in FAULTS],
)
def test_a_fault_is_found_by_its_name(
    tmp_path: Path,
    maker: Callable[[], CaptureMaker],
    code: str,
    severity: Severity,
    words: tuple[str, ...],
    frames: tuple[str, ...],
) -> None:
    found = check(maker(), tmp_path)
    finding = by_code(found)[code]
    assert finding.severity == severity and not (severity == ERROR and found.usable)
    assert all(word in finding.message for word in words), finding.message
    assert not frames or finding.frames == frames
    assert code != "light_drifts" or "color" in finding.blocks


@pytest.mark.parametrize(
    ("maker", "code"),
    [
        (lambda: spoilt([1, 5], lambda image: image[::-1, ::-1], circles=SOME), "channels_swapped"),
        (lambda: few(sensor="gelsight_mini"), "lamps_reversed"),
        (lambda: of_balls(range(4), 4.0, 4.0), "ball_contradicted"),
        (lambda: few(sensor="gelsight_mini", mm_per_px=0.1585), "scale_past_pad"),
    ],
)  # fmt: skip
def test_what_is_none_of_these_faults(
    tmp_path: Path, maker: Callable[[], CaptureMaker], code: str
) -> None:
    assert code not in by_code(check(maker(), tmp_path))


def test_duplicates(tmp_path: Path) -> None:
    circles = list(SOME)
    circles[4], circles[5] = circles[2], circles[2]
    maker = CaptureMaker(circles=circles)
    folder = maker.write(tmp_path)
    (folder / "p04.png").write_bytes((folder / "p02.png").read_bytes())
    codes = by_code(check_captures(load_capture_folder(folder), fit_ball=False))
    # p05 shows the same press with other noise.
    assert codes["duplicates"].frames == ("p02", "p04", "p05")
    assert set(codes["duplicates"].blocks) == {"color", "normals", "depth"}


@pytest.mark.thorough
def test_labels_that_disagree(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=list(SOME))
    maker.labels = [
        replace(c, u_px=c.u_px + 9, v_px=c.v_px + 2) if i in (2, 6) else c
        for i, c in enumerate(maker.circles)
    ]
    two = by_code(check(maker, tmp_path / "two"))["labels_off"]
    assert two.frames == ("p02", "p06") and two.severity == Severity.WARNING
    maker = few()
    maker.labels = [replace(c, u_px=c.u_px + 9) if c.u_px < 130 else c for c in maker.circles]
    many = by_code(check(maker, tmp_path / "many"))["labels_off"]
    assert many.severity == Severity.ERROR and "--circles detected" in many.message


@pytest.mark.thorough
def test_images_reject_single_labels_and_no_shift_that_all_share(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=list(SOME))
    maker.labels = [replace(c, u_px=c.u_px + 9) for c in maker.circles]
    maker.labels[2] = replace(maker.labels[2], u_px=maker.labels[2].u_px - 24)
    maker.change([5], lambda _: gel())
    found = check(maker, tmp_path)
    assert len(by_code(found)["labels_off"].frames) > 4
    assert found.rejected_labels == {"p02", "p05"}


def test_a_label_outside_the_image_is_told_once(tmp_path: Path) -> None:
    maker = few()
    maker.labels = [
        replace(c, u_px=c.u_px + 10 * WIDTH) if i == 2 else c for i, c in enumerate(maker.circles)
    ]
    told = [f for f in check(maker, tmp_path / "out").findings if f.code == "labels_off"]
    assert [remark.frames for remark in told] == [("p02",)]


def test_labels_of_images_of_another_size_are_told_so(tmp_path: Path) -> None:
    maker = few()
    maker.labels = [
        ContactCircle(0.5 * c.u_px, 0.5 * c.v_px, 0.5 * c.radius_px) for c in maker.circles
    ]
    halved = by_code(check(maker, tmp_path / "half"))["labels_off"]
    assert f"divided by 0.50: were they made in images of {WIDTH // 2}x" in halved.message
    maker.labels = [replace(c, u_px=c.u_px + 9) for c in maker.circles]
    moved = by_code(check(maker, tmp_path / "moved"))["labels_off"]
    assert "divided by" not in moved.message


def test_a_black_background_is_called_black(tmp_path: Path) -> None:
    found = check(few(background=np.zeros((HEIGHT, WIDTH, 3))), tmp_path)
    assert "background_differs" in by_code(found)
    state = {block.command: str(block.readiness) for block in found.blocks}
    assert state["background"] == state["color"] == "blocked"
    assert all(frame.contact is not None for frame in found.frames)


@pytest.mark.thorough
def test_labels_that_the_border_cuts_are_used_and_those_outside_are_told(tmp_path: Path) -> None:
    circles = [ContactCircle(WIDTH - 6.0, 60.0, 15.0), *spread_circles(3)]
    maker = CaptureMaker(circles=circles)
    found = by_code(check(maker, tmp_path / "cut"))
    assert "no_contact" not in found and "labels_off" not in found
    maker.labels[1] = ContactCircle(-4.0, 50.0, 20.0)
    maker.labels[2] = ContactCircle(WIDTH + 90.0, 50.0, 20.0)
    outside = check(maker, tmp_path / "outside").findings
    (impossible,) = [found for found in outside if "of no press" in found.message]
    assert impossible.code == "labels_off"
    assert impossible.severity == Severity.ERROR and impossible.frames == ("p01", "p02")
    assert "reaches into the image" in impossible.message


@pytest.mark.thorough
def test_grey_images_say_so_and_nothing_of_the_sensor(tmp_path: Path) -> None:
    def grey(image: np.ndarray) -> np.ndarray:
        return np.repeat(image.mean(axis=2, keepdims=True), 3, axis=2)

    maker = few(background=grey(gel()), labelled=False)
    maker.change(range(len(FEW)), grey)
    (color,) = [b for b in check(maker, tmp_path).blocks if b.command == "color"]
    assert color.missing == "coloured lamps: this sensor, or these images, are grey"


@pytest.mark.thorough
def test_colours_of_the_pictures_speak_where_contacts_have_none(tmp_path: Path) -> None:
    """As a DIGIT's that is pressed so that all three lamps lose alike."""
    maker = CaptureMaker(circles=spread_circles(3), sensor="gelsight_mini")
    for i, circle in enumerate(maker.circles):
        dome = np.clip(1 - (circle.distance_px(GRID) / circle.radius_px) ** 2, 0, None)
        maker.images[i] = gel() - 50 * dome[..., None]
    found = check(maker, tmp_path)
    assert "grey_or_colour" not in by_code(found)
    (color,) = [block for block in found.blocks if block.command == "color"]
    assert "coloured" not in color.missing


@pytest.mark.thorough
def test_pictures_without_a_contact_do_not_tell_the_lamps(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=spread_circles(4), labelled=False, sensor="gelsight_mini")
    bar = np.zeros((HEIGHT, WIDTH, 1))
    bar[:, 70:90] = -60.0
    maker.images = [gel() + bar] * 4
    found = check(maker, tmp_path)
    assert "grey_or_colour" not in by_code(found)
    (color,) = [block for block in found.blocks if block.command == "color"]
    assert str(color.readiness) == "blocked" and "coloured" not in color.missing


def test_a_background_of_another_size_needs_a_scale(tmp_path: Path) -> None:
    maker = few(mm_per_px=None)
    (block,) = [b for b in check(maker, tmp_path).blocks if b.command == "background"]
    assert str(block.readiness) == "blocked"
    assert block.missing.startswith(f"the scale (these images are {WIDTH}x{HEIGHT} px")


@pytest.mark.thorough
def test_frame_without_contact(tmp_path: Path) -> None:
    maker = CaptureMaker(labelled=False, circles=spread_circles(11))
    maker.images[8] = gel()
    found = check(maker, tmp_path)
    finding = by_code(found)["no_contact"]
    assert finding.frames == ("p08",) and finding.severity == Severity.WARNING and found.usable
    for i in (1, 3, 5, 7, 9):
        maker.images[i] = gel()
    found = check(maker, tmp_path / "many")
    assert by_code(found)["no_contact"].severity == Severity.ERROR and not found.usable


def crop_and_enlarge(image: np.ndarray, left: int, top: int, wide: int, high: int) -> np.ndarray:
    part = np.ascontiguousarray(image[top : top + high, left : left + wide])
    return cv2.resize(part, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)


@pytest.mark.thorough
def test_a_background_of_another_framing_gives_way_to_the_median(tmp_path: Path) -> None:
    background = crop_and_enlarge(gel(), 20, 15, 120, 90)
    found = check(CaptureMaker(circles=spread_circles(8), background=background), tmp_path)
    finding = by_code(found)["background_differs"]
    assert "--background median" in finding.message and not found.usable
    assert all(frame.contact is not None for frame in found.frames)


def test_no_background_falls_back_on_the_median(tmp_path: Path) -> None:
    folder = few().write(tmp_path)
    text = (folder / "captures.toml").read_text().replace('background = "background.png"\n', "")
    (folder / "captures.toml").write_text(text)
    found = check_captures(load_capture_folder(folder), fit_ball=False)
    assert "no_background" in by_code(found)
    assert all(frame.contact is not None for frame in found.frames)


@pytest.mark.parametrize(("radius_px", "told"), [(20.1, False), (22.0, False), (26.0, True)])
def test_a_contact_a_little_wider_than_its_ball_is_an_error_of_circles(
    tmp_path: Path, radius_px: float, told: bool
) -> None:
    """Of a ball of 2 mm, which ends at 20 px: a contact of 2.01 mm is one that is pressed deep."""
    maker = few()
    frames = check(maker, tmp_path).frames
    circles = [replace(label, radius_px=radius_px) for label in maker.labels]
    wide = [
        replace(frame, contact=None, press=replace(frame.press, circle=circle))
        for frame, circle in zip(frames, circles, strict=True)
    ]
    grid = PixelGrid(WIDTH, HEIGHT, 0.1, 0.1)
    found = check_balls(wide, grid, 2.0, None)
    assert ("ball_too_small" in {finding.code for finding in found}) == told


@pytest.mark.parametrize(
    ("stated", "wrong", "doubled"),
    [(2.0, False, False), (4.0, True, True), (0.8, True, False), (12.0, True, False)],
)
def test_ball_against_travel(tmp_path: Path, stated: float, wrong: bool, doubled: bool) -> None:
    """A diameter is only asked about where it would explain the travel."""
    circles = [replace(c, radius_px=c.radius_px - 6) for c in FEW]
    maker = CaptureMaker(circles=circles, radius_mm=stated, labelled=False)
    # Travel between those of an elastic gel (a^2 = R d) and of one that does not rise (2 R d).
    maker.extra = [f"depth_mm = {(0.1 * c.radius_px) ** 2 / (1.4 * 2.0):.4f}" for c in circles]
    codes = by_code(check(maker, tmp_path))
    assert ("ball_contradicted" in codes) == wrong
    if wrong:
        message = codes["ball_contradicted"].message
        assert f"stated is {stated:g} mm" in message and ("diameter" in message) == doubled


@pytest.mark.thorough
@pytest.mark.parametrize("stated", [2.0, 1.55])
def test_ball_against_slopes(tmp_path: Path, stated: float) -> None:
    maker = CaptureMaker(circles=spread_circles(6), radius_mm=stated, labelled=False)
    found = check_captures(maker.load(tmp_path))
    assert ("wrong_ball_radius" in by_code(found)) == (stated < 2.0)
    assert found.usable == (stated == 2.0)
    assert ("ball_from_below" in by_code(found)) == (stated == 2.0)


@pytest.mark.thorough
def test_a_larger_ball_is_asked_about_where_no_travel_tells(tmp_path: Path) -> None:
    """A diameter that is typed for the radius: colours fit it as well, and are said to."""
    maker = CaptureMaker(circles=spread_circles(6), radius_mm=4.0, labelled=False)
    found = by_code(check_captures(maker.load(tmp_path / "none")))
    assert found["ball_from_below"].severity == Severity.INFO
    assert "8.8 mm would leave" in found["ball_from_below"].message
    depths_mm = [(0.1 * c.radius_px) ** 2 / (1.4 * 2.0) for c in maker.circles]
    maker.extra = [f"depth_mm = {depth:.4f}" for depth in depths_mm]
    told = by_code(check_captures(maker.load(tmp_path / "travel")))
    assert "ball_contradicted" in told and "ball_from_below" not in told


def test_a_scale_ten_times_off_is_named(tmp_path: Path) -> None:
    """Of a sensor that is in no catalogue: 160 mm of gel, and contacts wider than the ball."""
    maker = few(mm_per_px=1.0, radius_mm=12.4)
    folder = maker.load(tmp_path)
    found = by_code(check_captures(folder, fit_ball=False))
    shown = "at 1 x 1 mm/px the image shows 160.0 x 120.0 mm, more than the pad"
    assert shown in found["scale_past_pad"].message
    assert "at 1 mm/px, the ball 12.4 mm" in found["ball_too_small"].message
    with pytest.raises(InputError, match=r"check the scale") as caught:
        base_profile(None, folder)
    assert shown in str(caught.value)


@pytest.mark.parametrize(("mm_per_px", "told"), [(0.05, True), (0.1, False), (0.25, False)])
def test_a_view_that_no_sensor_has(tmp_path: Path, mm_per_px: float, told: bool) -> None:
    """8 mm; the catalogue's sensors show 17 to 44."""
    found = by_code(check(few(mm_per_px=mm_per_px, radius_mm=5.0), tmp_path))
    assert ("scale_unusual" in found) == told
    low, high = catalogue_view_mm()
    assert 10 < low < 17 and 44 < high < 60


def test_view_past_the_pad(tmp_path: Path) -> None:
    maker = few(sensor="gelsight_mini", mm_per_px=0.25, radius_mm=5.0)
    found = check(maker, tmp_path)
    assert by_code(found)["scale_past_pad"].severity == Severity.ERROR
    states = {block.command: str(block.readiness) for block in found.blocks}
    assert states["color"] == states["normals"] == "blocked"


def test_radius_and_scale_that_nobody_states(tmp_path: Path) -> None:
    found = check(few(radius_mm=None, mm_per_px=None), tmp_path)
    assert {"ball_radius_unstated", "scale_unstated"} <= set(by_code(found))
    color = next(block for block in found.blocks if block.command == "color")
    assert color.missing == "the ball's radius, the scale" and color.readiness == "blocked"


@pytest.mark.thorough
def test_a_pressed_frame_as_background(tmp_path: Path) -> None:
    maker = CaptureMaker(circles=spread_circles(8))
    maker.background = press(ContactCircle(100.0, 70.0, 16.0))
    found = by_code(check(maker, tmp_path))
    assert found["background_pressed"].severity == Severity.ERROR
    assert "(100, 7" in found["background_pressed"].message
    # All presses at one place have one median, too, and yet the gel was untouched.
    maker = CaptureMaker(circles=[ContactCircle(80.0, 60.0, 15.0)] * 8)
    assert "background_pressed" not in by_code(check(maker, tmp_path / "one"))
