# SPDX-License-Identifier: Apache-2.0
"""G-code keeps the ball off the gel and inside the printer; its captures get depths and places."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture import import_captures, load_capture_folder
from taccel_lab.calibration.capture.camera.camera import CameraInfo
from taccel_lab.calibration.capture.guide import capture_plan
from taccel_lab.calibration.capture.printer import (
    CLEAR_MM,
    PRINTERS,
    SLOW,
    SLOW_MM,
    PrinterPlan,
    parse_printer,
    printer_plan,
    read_press_table,
)
from taccel_lab.calibration.record.folder import RecordFacts, open_record
from taccel_lab.errors import InputError
from taccel_lab.sensors import sensor_family
from tests.calibration.capture.made_up_layouts import pictures

TOUCH = (110.0, 105.0, 67.0)
MOVE = re.compile(r"G1((?: [XYZ]-?[0-9.]+)+) F(\d+)")


def moves(plan: PrinterPlan) -> list[tuple[np.ndarray, int]]:
    """Where a printer that follows the program goes, and at which feed; X, Y, Z [mm]."""
    at, found = np.array([*TOUCH[:2], 200.0]), []
    for line in plan.gcode().splitlines():
        code = line.split(";")[0].strip()
        assert not code.startswith("G28")
        if code.startswith("G1"):
            move = MOVE.fullmatch(code)
            assert move is not None, line
            for word in move[1].split():
                at["XYZ".index(word[0])] = float(word[1:])
            found.append((at.copy(), int(move[2])))
    return found


@pytest.mark.thorough(cases=("digit",))
@pytest.mark.parametrize("sensor", ["gelsight_mini", "digit", "gelsight", "9dtact", "flat_pad"])
def test_the_ball_travels_above_the_gel_and_enters_it_slowly(sensor: str) -> None:
    plan, known = printer_plan(sensor, PRINTERS["ender3"], TOUCH), capture_plan(sensor)
    wanted = [press.depth_mm for press in plan.presses]
    assert len(wanted) == known.press_count and max(wanted) == known.depth_mm
    pad, radius = sensor_family(sensor).parameters().pad(), plan.ball_radius_mm
    steps = np.linspace(-radius, radius, 41)
    around = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    around = around[np.hypot(*around.T) < radius]
    ball = radius - np.sqrt(radius**2 - (around**2).sum(axis=1))
    top = float(pad.top_mm(np.zeros((1, 2)))[0])

    def into_gel_mm(at: np.ndarray) -> float:
        """How deep the ball is in the resting face."""
        underside = at[2] - TOUCH[2] + top + ball
        face = pad.top_mm(at[:2] - TOUCH[:2] + around)
        return float(np.nanmax(np.where(np.isfinite(face), face - underside, -9.0)))

    deepest = []
    for (before, _), (after, feed) in itertools.pairwise(moves(plan)):
        if (before[:2] != after[:2]).any():
            assert before[2] == after[2] == TOUCH[2] + CLEAR_MM
        elif feed != SLOW:
            assert into_gel_mm(after) < -0.5 * SLOW_MM
        if feed == SLOW and after[2] < before[2]:
            deepest.append(into_gel_mm(after))
    assert deepest == pytest.approx(wanted, abs=0.02)


def test_presses_lie_on_the_gel_that_the_camera_sees() -> None:
    plan = printer_plan("gelsight_mini", (250.0, 210.0, 220.0), TOUCH)
    grid = sensor_family("gelsight_mini").parameters().grid()
    places = np.array([(press.x_mm, press.y_mm) for press in plan.presses])
    deep = plan.presses[2].depth_mm
    rim = np.sqrt(deep * (2 * plan.ball_radius_mm - deep))
    assert (abs(places) + rim < np.array([grid.width_px, grid.height_px]) * 0.0634 / 2 + 0.1).all()
    assert len(np.unique(places, axis=0)) == 16 and np.ptp(places[:, 0]) > 12
    assert 5 < plan.minutes < 20 and "G28" in plan.gcode()


@pytest.mark.parametrize(("sensor", "printer", "touch", "said"), [
    ("9dtact", "220x220x250", (5.0, 105.0, 67.0), r"--touch has X = 5 mm; .* is allowed"),
    ("9dtact", "220x220x250", (110.0, 216.0, 67.0), "--touch has Y = 216 mm"),
    ("9dtact", "220x220x250", (110.0, 105.0, 0.5), "--touch has Z = 0.5 mm"),
    ("9dtact", "220x220x250", (110.0, 105.0, 247.0), "--touch has Z = 247 mm"),
    ("9dtact", "220x220x250", (float("nan"), 105.0, 67.0), "--touch has X = nan"),
    ("9dtact", "replicator", TOUCH, "ender3, prusa_mk4 or the build volume"),
    ("digit_360", "ender3", TOUCH, "digit_360 is a dome"),
])  # fmt: skip
def test_what_the_printer_does_not_reach_is_refused(
    sensor: str, printer: str, touch: tuple[float, float, float], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        printer_plan(sensor, parse_printer(printer), touch)


def test_photographs_get_depths_and_places(tmp_path: Path) -> None:
    plan, source = printer_plan("9dtact", PRINTERS["ender3"], TOUCH), tmp_path / "plan"
    pictures(source, "background", *(press.image for press in plan.presses))
    (source / "printer_presses.csv").write_text(plan.table())
    [path] = import_captures(source, tmp_path / "out")
    presses = load_capture_folder(path).presses
    assert len(presses) == 10
    for press, made in zip(presses, plan.presses, strict=True):
        assert (press.depth_mm, press.radius_mm) == (made.depth_mm, plan.ball_radius_mm)
        assert press.stage_mm == pytest.approx((made.x_mm, made.y_mm))


def test_a_session_takes_the_table_only_where_it_is_in_step(tmp_path: Path) -> None:
    plan, table = printer_plan("9dtact", PRINTERS["ender3"], TOUCH), tmp_path / "presses.csv"
    table.write_text(plan.table())
    made = read_press_table(table)
    facts = RecordFacts("9dtact", 4.0, None, "later", None, None, False, "")
    facts = replace(facts, camera=CameraInfo("a", "a"))
    image = np.random.default_rng(0).integers(90, 110, (96, 128, 3)).astype(np.uint8)
    with open_record(tmp_path / "captures", facts, made) as folder:
        folder.set_background(image, facts)
        for _ in made[1:]:
            folder.add_press(image)
        folder.finish()
        assert folder.out_of_step == (
            "9 presses were taken and the table has 10: which is which is not known, so that none "
            "gets a depth. Record them again"
        )
        assert not any("depth_mm" in press for press in folder.manifest["presses"])
        folder.add_press(image)
        folder.finish()
        assert not folder.out_of_step
    presses = load_capture_folder(tmp_path / "captures").presses
    assert [press.depth_mm for press in presses] == [press.depth_mm for press in plan.presses]
    table.write_text("image,x_mm,y_mm,depth_mm\na.png,0,0,-1\n")
    with pytest.raises(InputError, match="line 2: depth_mm is -1; 0 to 50 mm"):
        read_press_table(table)
