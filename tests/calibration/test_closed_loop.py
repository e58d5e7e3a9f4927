# SPDX-License-Identifier: Apache-2.0
"""Solver, ray-cast camera, calibration, and an object that is no ball and that neither saw.

The captures are made by what the calibration does not use: a mesh of their own, graded for a disc
whatever touches, friction under the tool, a camera with perspective, refraction and shadows, and
noise. The profile then has to say what a roller looks like, and to read its shape from the picture.
"""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.calibration.normals.samples import angle_between_deg
from taccel_lab.cli.app import main
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics.image_measures import psnr_db
from taccel_lab.optics.render import OpticalModel
from taccel_lab.presses import (
    PressOutcome,
    PressPath,
    PressSetup,
    SeenFrom,
    parse_indenter,
    simulate_press,
)
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.presses.mesh_options import PressMeshOptions
from taccel_lab.presses.physics import PHYSICS, Accuracy
from taccel_lab.profile import SensorProfile, load_profile
from taccel_lab.reading.reader import Reader
from taccel_lab.scene import Material
from taccel_lab.sensors.registry import sensor_family
from tests.calibration.drawn.faults import quantise
from tests.support.synthetic_presses import write_folder

FAMILY, BALL_MM, PRESSES = "gelsight_mini", 2.0, 14
LONGEST_PX, CUT, NOISE_LEVELS, FRICTION = 224, 0.06, 1.5, 0.3
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]
TRUTH = replace(
    PHYSICS[Accuracy.DEFAULT],
    mesh=PressMeshOptions(elements_per_radius=4.5, core=6, rings=8, layers=3),
)
CONTACT_MM = 1.3
"""Radius of the disc that meshes of the captures are graded for, whatever touches."""
OBJECT, OBJECT_AT_MM, OBJECT_DEPTH_MM = "roller:1.5x4", (1.2, -0.8), 0.5


class Camera:
    """The optical model of the catalogue, cut to the middle of its picture."""

    def __init__(self) -> None:
        parameters = sensor_family(FAMILY).parameters(None)
        design = parameters.optics()
        assert design is not None
        self.design = design
        width, height = self.size = design.camera.size_within(LONGEST_PX, enlarged=True)
        model = OpticalModel(design, gel_mesh(parameters.pad()), size_px=self.size)
        points = model.render().points_mm
        du, dv = round(CUT * width), round(CUT * height)
        self.window = (slice(dv, height - dv), slice(du, width - du))
        x_mm, y_mm = (float(np.nanmedian(np.diff(points[..., k], axis=1 - k))) for k in (0, 1))
        # The plain scale that a person would state: millimetres per pixel in the middle.
        self.grid = PixelGrid(width - 2 * du, height - 2 * dv, x_mm, y_mm)

    def shot(self, outcome: PressOutcome, pressed: bool, rng: np.random.Generator) -> np.ndarray:
        """A noisy picture, RGB uint8."""
        model = OpticalModel(self.design, outcome.mesh, size_px=self.size)
        seen = model.render(outcome.positions_m if pressed else None)
        clean = model.display.levels(seen.linear)[self.window]
        return quantise(clean + rng.normal(0, NOISE_LEVELS, clean.shape))


def truth(grid: PixelGrid, indenter: str, at_mm: tuple[float, float], depth_mm: float) -> Any:
    """A press as it happens on the bench."""
    tool = parse_indenter(indenter)
    mesh = press_mesh(FAMILY, {}, at_mm, CONTACT_MM, TRUTH.mesh)
    setup = PressSetup(mesh, Material(1.5e5, 0.48), tool, FRICTION, TRUTH)
    return simulate_press(setup, at_mm, PressPath(depth_mm), SeenFrom(grid))


@pytest.fixture(scope="module")
def loop(tmp_path_factory) -> tuple[SensorProfile, dict[str, Any], PressOutcome, np.ndarray]:
    """Calibrated profile, report of its colours, the object's press, and its picture."""
    folder = tmp_path_factory.mktemp("loop")
    rng = np.random.default_rng(11)
    camera = Camera()
    grid = camera.grid
    size_mm = np.array([grid.width_px * grid.mm_per_px_x, grid.height_px * grid.mm_per_px_y])
    reach = 0.5 * size_mm - 2.2
    images = {}
    for i in range(PRESSES):
        at_mm = (float(rng.uniform(-reach[0], reach[0])), float(rng.uniform(-reach[1], reach[1])))
        outcome = truth(grid, f"sphere:{BALL_MM}", at_mm, float(rng.uniform(0.45, 0.85)))
        if i == 0:
            untouched = camera.shot(outcome, False, rng)
        images[f"press_{i}"] = camera.shot(outcome, True, rng)
    captures = write_folder(folder / "captures", untouched, images, {}, BALL_MM, grid, FAMILY)
    out = folder / "unit"
    # 1: a stage had captures that are weak; what was calibrated is there nevertheless.
    only = ("--only", "color", "normals")
    assert main(["calibrate", "all", str(captures), "--out", str(out), *only]) in (0, 1)
    report = json.loads((folder / "unit_report" / "color" / "report.json").read_text())["color"]
    pressed = truth(grid, OBJECT, OBJECT_AT_MM, OBJECT_DEPTH_MM)
    return load_profile(out), report, pressed, camera.shot(pressed, True, rng)


def wider(at: np.ndarray) -> slice:
    """From the first to the last place, and 0.3 of that beyond either."""
    more = round(0.3 * (at[-1] - at[0]))
    return slice(max(0, at[0] - more), at[-1] + 1 + more)


def test_balls_that_were_held_out_are_rendered(loop: Any) -> None:
    report = loop[1]
    assert report["heldout_placed_by"] == "found" and report["failures"] == {}
    bare = report["background_only"]["crop_psnr_db"]
    assert report["heldout"]["crop_psnr_db"] > bare + 6


def test_an_object_that_is_no_ball_is_rendered_and_its_shape_read(loop: Any) -> None:
    profile, _, pressed, image = loop
    how = {"at_mm": OBJECT_AT_MM, "depth_mm": OBJECT_DEPTH_MM, "friction": 0.0}
    rendered = np.asarray(tl.press(profile, OBJECT, **how).image, dtype=float)
    contact = pressed.contact_mask
    crop = tuple(wider(np.flatnonzero(contact.any(axis=axis))) for axis in (1, 0))
    found, bare = (psnr_db(of[crop], image[crop]) for of in (rendered, profile.background_rgb))
    assert found > bare + 5
    error, nothing = (
        np.abs(of - image)[contact].mean() for of in (rendered, profile.background_rgb)
    )
    assert error < 0.5 * nothing
    reading = Reader(profile).read(image)
    off, flat = (
        angle_between_deg(of, pressed.normals)[contact].mean()
        for of in (reading.normals, pressed.rest_normals)
    )
    assert off < 0.6 * flat
    sunk = (pressed.height_m - pressed.rest_height_m)[contact]
    assert np.abs(reading.depth_m[contact] + sunk).mean() < -0.5 * sunk.mean()
