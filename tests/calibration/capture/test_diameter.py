# SPDX-License-Identifier: Apache-2.0
"""A ball's diameter that stands where its radius should: told by contacts and travel, or held by
the intervals of what is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.base_profile import base_profile
from taccel_lab.calibration.capture import CaptureFolder, load_capture_folder
from taccel_lab.calibration.capture.captures import CaptureSet, Frame
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.depth.fit import calibrate_depth
from taccel_lab.calibration.normals.fit import calibrate_normals
from taccel_lab.calibration.normals.options import NormalOptions
from taccel_lab.reading.reader import Reader
from taccel_lab.report.remark import Severity
from tests.calibration.depth import test_depth as grey
from tests.calibration.normals.conftest import short_color_fits, sunk_captures
from tests.support.capture_sets import CaptureMaker, edit_manifest, spread_circles
from tests.support.commands import refusal, run
from tests.support.real_data import labelled_presses
from tests.support.synthetic_presses import GRID, flat_profile, write_captures, write_folder

TRUE_MM = 2.0
RVSATHU = "gelsight_rvsathu_sim2real"
MAY_BE = "may be its diameter"


@pytest.fixture(autouse=True)
def _other_tools_are_drawn_shortly() -> Iterator[None]:
    with short_color_fits():
        yield


def maker(stated_mm: float, smaller_px: float = 0.0, depths: bool = False) -> CaptureMaker:
    circles = [replace(c, radius_px=c.radius_px - smaller_px) for c in spread_circles(4)]
    made = CaptureMaker(circles=circles, radius_mm=stated_mm)
    if depths:
        # Between Hertz's contact and that of a gel that does not rise beside the ball.
        for i, circle in enumerate(circles):
            contact_mm = circle.radius_px * GRID.mm_per_px_x
            made.extra[i] = f"depth_mm = {contact_mm**2 / (1.4 * TRUE_MM):.3f}"
    return made


def said(folder: CaptureFolder) -> dict[str, Severity]:
    found = check_captures(folder, fit_ball=False).findings
    return {one.code: one.severity for one in found if one.code.startswith("ball_")}


def codes(folder: Path) -> dict[str, Severity]:
    return said(load_capture_folder(folder))


ASKED = {"ball_or_diameter": Severity.WARNING}


def test_contacts_wider_than_half_of_it_tell(tmp_path: Path) -> None:
    assert codes(maker(TRUE_MM).write(tmp_path / "sound")) == {}
    assert codes(maker(2 * TRUE_MM).write(tmp_path / "doubled")) == ASKED
    assert codes(maker(TRUE_MM, 6.0).write(tmp_path / "shallow")) == ASKED


def test_travel_tells(tmp_path: Path) -> None:
    assert codes(maker(TRUE_MM, 6.0, depths=True).write(tmp_path / "sound")) == {}
    doubled = codes(maker(2 * TRUE_MM, 6.0, depths=True).write(tmp_path / "doubled"))
    assert doubled in (ASKED, {"ball_contradicted": Severity.ERROR})


def test_a_stated_diameter_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = maker(TRUE_MM, 6.0).write(tmp_path / "captures")
    assert run("capture", "check", folder) == 0 and "diameter_mm" in capsys.readouterr().out
    edit_manifest(folder, "radius_mm = 2.0", "radius_mm = 2.0\ndiameter_mm = 4.0")
    assert codes(folder) == {}
    edit_manifest(folder, "radius_mm = 2.0\ndiameter_mm = 4.0", "diameter_mm = 4.0")
    assert codes(folder) == {} and load_capture_folder(folder).ball_radius_mm == 2.0
    edit_manifest(folder, "diameter_mm = 4.0", "radius_mm = 4.0\ndiameter_mm = 4.0")
    said = refusal(capsys, "capture", "check", folder)
    assert "diameter_mm is 4, twice the radius_mm of 4 is 8" in said


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "labels", "background", "ball_mm", "mm_per_px"),
    [
        ("fots_calib", "labels_gelsight.csv", "mlp_calib/0000.png", 2.35, 0.05107),
        (RVSATHU, "labels/calib_labels.csv", "background_real.png", 2.92, 0.05926),
    ],
)
def test_real_balls(
    name: str, labels: str, background: str, ball_mm: float, mm_per_px: float, tmp_path: Path
) -> None:
    captures = labelled_presses(name, labels, background, ball_mm, mm_per_px)
    folder = CaptureFolder(
        source=name, root=tmp_path, sensor="flat_pad", unit=None, untouched=(), mask=None,
        background=Frame("background", name, "0" * 64, partial(np.copy, captures.background)),
        mm_per_px=(mm_per_px, mm_per_px), ball_radius_mm=ball_mm, presses=captures.presses[::3],
    )  # fmt: skip
    assert said(folder) == {}
    assert said(replace(folder, ball_radius_mm=2 * ball_mm)) == ASKED


Known = tuple[CaptureSet, dict[int, float]]


@pytest.fixture(scope="module")
def known() -> Known:
    """Presses, and how deep each that is held out is [mm]."""
    captures, surfaces = sunk_captures()
    return captures, {i: surfaces[i].depth_mm for i in captures.split(4).heldout}


def calibrated(folder: Path, captures: CaptureSet, stated: str) -> Reader:
    write_captures(folder, captures)
    edit_manifest(folder, "radius_mm = 2.0", stated)
    options = NormalOptions(synthetic_presses=6, steps=120, circles="labels")
    base = flat_profile(GRID, 4.0)
    return Reader(calibrate_normals(load_capture_folder(folder), base, options).apply_to(base))


@pytest.mark.thorough
def test_intervals_hold_the_depths_of_both_balls(tmp_path: Path, known: Known) -> None:
    captures, depths = known
    reader = calibrated(tmp_path / "doubled", captures, "radius_mm = 4.0")
    for i, depth_mm in depths.items():
        found = reader.read(captures.presses[i].image())
        assert found.depth_interval_mm is not None
        low, high = found.depth_interval_mm
        assert low < found.depth_mm < 0.6 * depth_mm < depth_mm < high
        assert any(MAY_BE in note for note in found.notes)


@pytest.mark.thorough
def test_a_ball_that_is_known_widens_nothing(tmp_path: Path, known: Known) -> None:
    captures, depths = known
    reader = calibrated(tmp_path / "known", captures, "diameter_mm = 4.0")
    for i, depth_mm in depths.items():
        found = reader.read(captures.presses[i].image())
        assert found.depth_interval_mm is not None and found.depth_interval_mm[0] > 0.6 * depth_mm
        assert not any(MAY_BE in note for note in found.notes)


def test_grey_sensors_hold_both_as_well(tmp_path: Path) -> None:
    presses = grey.captures_of(grey.CIRCLES, noise=1.0)
    images = {press.name: grey.quantise(press.image()) for press in presses.presses}
    depths = {}
    for ball_mm in (grey.BALL_MM, 2 * grey.BALL_MM):
        folder = write_folder(
            tmp_path / f"{ball_mm:g}", presses.background.astype(np.uint8), images, {}, ball_mm,
            grey.GRID, "9dtact",
        )  # fmt: skip
        captures = load_capture_folder(folder)
        base = base_profile(None, captures)
        reader = Reader(calibrate_depth(captures, base, grey.RIM).apply_to(base))
        depths[ball_mm] = reader.read(images["p2"])
    sound, doubled = depths.values()
    assert doubled.depth_interval_mm is not None
    low, high = doubled.depth_interval_mm
    assert low < doubled.depth_mm < 0.6 * sound.depth_mm < sound.depth_mm < high
    assert any(MAY_BE in note for note in doubled.notes)
    assert not any(MAY_BE in note for note in sound.notes)
