# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press`` from the command line to the files it leaves."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import pyvista

from taccel_lab.cli import app
from taccel_lab.errors import SimulationError
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.optics.render import OpticalModel
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.env import PressEnv
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.profile.schema import BranchEntry
from taccel_lab.scene import Element
from taccel_lab.solvers import StepReport
from tests.cli.conftest import Cli
from tests.geometry.vtu_files import read_mesh_vtu
from tests.signals.find_dots import distances_px, find_dots
from tests.support.commands import run
from tests.support.small_captures import everything_below, write_profile

FILES = {
    OUTPUT_MARKER, "contact_pressure.png", "force_depth.png", "gel.vtu", "height_map.png",
    "normals.png", "scene.png", "press.json", "times.json", "signals.npz", "report.html",
}  # fmt: skip
PREDICTED = {"predicted.png"}
"""Of a sensor without colour model whose optics are known."""
QUICK = "--accuracy fast --friction 0"


def quicken(patch: pytest.MonkeyPatch) -> None:
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    patch.setitem(PHYSICS, Accuracy.FAST, fast)
    patch.setattr("taccel_lab.presses.files.PREDICTED_PX", 64)


@pytest.fixture(autouse=True)
def small_pictures_and_quick_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    quicken(monkeypatch)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GelSight without colour model whose pictures are small."""
    return write_profile(tmp_path_factory.mktemp("unit") / "unit", color=False)


@pytest.fixture(scope="module")
def shallow(unit: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a press of 0.2 mm."""
    out = tmp_path_factory.mktemp("shallow") / "press"
    with pytest.MonkeyPatch.context() as patch:
        quicken(patch)
        assert press(unit, out, f"--depth-mm 0.2 {QUICK}") == 0
    return out


def press(sensor: object, out: Path, options: str, *more: object) -> int:
    return run("press", sensor, "--out", out, *options.split(), *more)


def read(out: Path) -> dict[str, Any]:
    return json.loads((out / "press.json").read_text())


@pytest.mark.thorough
@pytest.mark.rasterised
def test_press_on_a_sensor_of_the_catalogue(tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "deep" / "press"
    options = "--depth-mm 0.4 --at-mm 1.0 -0.5 --shear-mm 0.1 0 --twist-deg 2 --accuracy fast"
    said = cli("press gelsight --out", out, *options.split())
    assert {path.name for path in out.iterdir()} == FILES | PREDICTED
    assert cv2.imread(str(out / "predicted.png")).shape == (48, 64, 3)
    assert os.listdir(out.parent) == ["press"]
    page = (out / "report.html").read_text(encoding="utf-8")
    opening = ("image, predicted by the design", "contact, dark", "deepest place", "normal force",
               'href="press.json"', "smallest gap", "Force over depth.")  # fmt: skip
    assert [text for text in opening if text not in page] == []
    values = read(out)
    figures, force = values["press"], values["press"]["wrench"]["force_n"]
    assert figures["force_n"] == force[2] > 0 > force[0]
    assert 0 <= figures["residual_n"] <= 1e-4 * figures["contact_force_sum_n"]
    assert 0 < figures["min_distance_m"] < 2e-5 and figures["smallest_volume_ratio"] > 0
    assert figures["newton_iterations"] >= figures["step_count"] == len(figures["steps"]) == 3
    assert (values["sensor"], values["indenter"]) == ("gelsight", "sphere:2.0")
    assert values["at_mm"] == [1.0, -0.5]
    assert values["path"] == {"depth_mm": 0.4, "shear_mm": [0.1, 0.0], "twist_deg": 2.0}
    assert values["friction_coefficient"] == 1.0
    assert values["material"] == {"young_modulus_pa": 150000.0, "poisson_ratio": 0.46}
    assert values["indenter_pose"][:2] == pytest.approx([1.1e-3, -0.5e-3])
    assert said.out == ""
    for words in ("force of the gel on the indenter", "smallest gap", "wrote"):
        assert words in said.err

    with np.load(out / "signals.npz") as stored:
        signals = dict(stored)
    assert set(signals) == {
        "height_m", "rest_height_m", "normals", "rest_normals", "contact_mask", "contact_forces_n",
        "contact_pressures_pa",
    }  # fmt: skip
    assert signals["height_m"].shape == signals["contact_mask"].shape == (480, 640)
    assert signals["normals"].shape == (480, 640, 3)
    sunk = signals["height_m"] - signals["rest_height_m"]
    v, u = np.unravel_index(np.nanargmin(sunk), sunk.shape)
    assert (u - 319.5) * 0.0295 == pytest.approx(1.1, abs=0.2)
    assert (v - 239.5) * 0.0295 == pytest.approx(-0.5, abs=0.2)
    assert signals["contact_forces_n"].sum(axis=0) == pytest.approx(-np.array(force), rel=1e-6)
    mesh = read_mesh_vtu(out / "gel.vtu")
    assert values["mesh"]["node_count"] == mesh.node_count
    assert values["mesh"]["tet_count"] == mesh.tet_count
    for path in out.glob("*.png"):
        assert path.name in PREDICTED or cv2.imread(str(path)).std() > 5, path.name


@pytest.mark.rasterised
def test_light_is_followed_once_for_picture_and_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    followed = []
    light_of = OpticalModel.light_of

    def counted(model: OpticalModel, face: Any) -> Any:
        followed.append(face)
        return light_of(model, face)

    monkeypatch.setattr(OpticalModel, "light_of", counted)
    assert press("gelsight", tmp_path / "out", f"--depth-mm 0.2 {QUICK}") == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "image, predicted by the design" in page and (tmp_path / "out/predicted.png").is_file()
    assert len(followed) == 2, "at rest, for the exposure, and pressed"


@pytest.mark.thorough
def test_equal_presses_write_equal_figures(unit: Path, shallow: Path, tmp_path: Path) -> None:
    assert press(unit, tmp_path / "again", f"--depth-mm 0.2 {QUICK}") == 0
    for name in ("press.json", "gel.vtu", "signals.npz"):
        assert (tmp_path / "again" / name).read_bytes() == (shallow / name).read_bytes(), name
    times = json.loads((shallow / "times.json").read_text())
    assert times["seconds"] > sum(times["step_seconds"]) > 0


@pytest.mark.thorough
def test_a_texture_shows_in_the_heights(
    unit: Path, shallow: Path, tmp_path: Path, cli: Cli
) -> None:
    """The same press with and without ridges along y, 0.5 mm apart."""
    picture = tmp_path / "ridges.png"
    cv2.imwrite(str(picture), np.tile(np.array([0, 0, 255, 255], dtype=np.uint8), (4, 1)))
    options = f"{QUICK} --texture-mm 0.02 0.5"
    assert press(unit, tmp_path / "out", f"--depth-mm 0.2 {options}", "--texture", picture) == 0
    smooth, ridged = read(shallow), read(tmp_path / "out")
    assert smooth["texture"] is None and smooth["press"]["fine_force_n"] is None
    assert ridged["texture_mm"] == [0.02, 0.5]
    # The mean surface is 10 um higher.
    assert 0.85 < ridged["press"]["force_n"] / smooth["press"]["force_n"] < 0.99
    assert 0.7 < ridged["press"]["fine_force_n"] / ridged["press"]["force_n"] < 1.2
    bends = []
    for folder in (shallow, tmp_path / "out"):
        with np.load(folder / "signals.npz") as signals:
            height, mask = signals["height_m"], signals["contact_mask"]
        bends.append(np.abs(np.diff(height, 2, axis=1))[mask[:, 1:-1]].mean())
    assert bends[1] > 1.5 * bends[0]
    bad = ("press", unit, "--out", tmp_path / "bad", "--depth-mm", "0.005", "--texture", picture)
    assert "press deeper" in cli.refusal(*bad, *options.split())
    assert not (tmp_path / "bad").exists()


@pytest.mark.thorough
def test_a_press_to_a_force_is_one_to_its_depth(unit: Path, tmp_path: Path) -> None:
    assert press(unit, tmp_path / "force", f"--force-n 0.6 {QUICK}") == 0
    found = read(tmp_path / "force")
    assert found["asked_force_n"] == 0.6
    assert found["press"]["force_n"] == pytest.approx(0.6, rel=0.01)
    assert press(unit, tmp_path / "depth", f"--depth-mm {found['path']['depth_mm']!r} {QUICK}") == 0
    again = read(tmp_path / "depth")
    assert again["asked_force_n"] is None
    assert again["press"]["wrench"] == found["press"]["wrench"]
    assert again["mesh"] == found["mesh"]


@pytest.mark.thorough
def test_a_hold_and_a_way_back_are_told(unit: Path, tmp_path: Path, cli: Cli) -> None:
    profile = load_profile(unit)
    soft = profile.material.replace(branches=(BranchEntry(relative_modulus=0.5, time_s=1.0),))
    save_profile(profile.with_block(soft), tmp_path / "soft")
    path = f"--depth-mm 0.2 --hold-s 3 --unload {QUICK}"
    shown = cli("press", tmp_path / "soft", "--out", tmp_path / "out", *path.split()).err
    found = read(tmp_path / "out")["press"]
    assert found["travel_mm"] == pytest.approx(0.2), "of a press that comes back, too"
    assert found["hold"]["to_n"] < 0.9 * found["hold"]["from_n"]
    assert f"{found['hold']['from_n']:.4g}  {found['hold']['to_n']:.4g}" in shown
    assert f"{found['loop']['work_mj']:.4g}  {found['loop']['lost_mj']:.4g}" in shown
    rows = [line.split() for line in shown.splitlines() if "past first touch" in line]
    assert [row[-2] for row in rows] == ["0.2", "0"]


@pytest.mark.thorough
def test_options_reach_the_solver(unit: Path, tmp_path: Path) -> None:
    options = f"--depth-mm 0.3 --step-mm 0.1 {QUICK}"
    assert press(unit, tmp_path / "a", options) == 0
    assert press(unit, tmp_path / "b", f"{options} --tolerance 1e-7 --dhat-mm 0.05") == 0
    a, b = (read(tmp_path / name)["press"] for name in "ab")
    assert a["step_count"] == 3
    # The absolute tolerance of 1e-7 N is always good enough.
    assert b["residual_n"] <= 1e-7 < a["residual_n"] <= 1e-4 * a["contact_force_sum_n"]
    assert a["min_distance_m"] < 2e-5 < b["min_distance_m"] < 5e-5


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("error", "code"),
    [pytest.param(SimulationError("stuck"), 3, marks=pytest.mark.slow), (KeyboardInterrupt(), 130)],
)
def test_finished_steps_are_kept(
    unit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    """A press that stops in its third step is the one that ends with its second, and says so."""
    # The contact range follows the depth that is aimed at, unless it is given.
    options = f"--step-mm 0.1 --dhat-mm 0.005 --mesh profile --states {QUICK} --friction 0.5"
    options += " --depth-mm"
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert press(unit, whole, options, "0.2") == 0
    gap, move = PressEnv._mean_gap_m, PressEnv.move_to

    def interrupt(self: PressEnv) -> np.ndarray:
        # The step has moved everything by now.
        if self.depth_m[0] > 1.9e-4:
            raise error
        return gap(self)

    def fail(self: PressEnv, depth_mm: float, *words: Any) -> StepReport:
        if depth_mm > 0.25:
            raise error
        return move(self, depth_mm, *words)

    if code == 3:
        monkeypatch.setattr(PressEnv, "move_to", fail)
    else:
        monkeypatch.setattr(PressEnv, "_mean_gap_m", interrupt)
    assert press(unit, out, options, "0.4") == code
    found, wanted = read(out), read(whole)
    assert wanted["mesh"]["tet_count"] == load_profile(unit).mesh.tet_count
    assert found["failure"] == (str(error) or "interrupted")
    assert wanted["failure"] is wanted["press"]["stopped"] is None
    assert found["press"]["stopped"]["depth_mm"] == pytest.approx(0.3)
    assert found["press"]["stopped"]["why"] == found["failure"]
    assert found["press"]["force_n"] == wanted["press"]["force_n"] > 0
    assert found["press"]["step_count"] == 2
    assert {p.name for p in out.iterdir()} == {p.name for p in whole.iterdir()}
    for name in ("signals.npz", "states.npz"):
        with np.load(out / name) as mine, np.load(whole / name) as theirs:
            for key in theirs.files:
                np.testing.assert_array_equal(mine[key], theirs[key], err_msg=key)
    # Whoever interrupts keeps an earlier result; one that fails again has a new one.
    before = everything_below(whole)
    assert press(unit, whole, options, "0.4") == code
    assert (everything_below(whole) == before) == (code == 130)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("moment", "where", "missing"),
    [
        ("coarser press", "presses.numerical_error._by_rule", ["the numerical error"]),
        ("image", "presses.press.predicted_image", ["pictures", "the page"]),
        ("page", "presses.page.write_press_page", ["pictures", "the page"]),
    ],
)
@pytest.mark.parametrize("code", [130, 143])
def test_a_press_that_is_stopped_after_its_steps_keeps_them(
    moment: str,
    where: str,
    missing: list[str],
    code: int,
    unit: Path,
    shallow: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    cli: Cli,
) -> None:
    """As of the press that ends by itself; said in the file, on the console and by the code."""
    out, stop = tmp_path / "out", KeyboardInterrupt if code == 130 else app._Terminated

    def stopped(*_: object, **__: object) -> None:
        raise stop

    monkeypatch.setattr(f"taccel_lab.{where}", stopped)
    words = ("press", unit, "--out", out, "--depth-mm", "0.2", *QUICK.split())
    said = cli(*words, code=code).err.splitlines()[-1]
    found, whole = read(out), read(shallow)
    ended = "interrupted" if code == 130 else "terminated"
    steps = f"{len(whole['press']['steps'])} finished steps, to 0.2 mm"
    assert said == f"{ended}; {out} has {steps}; missing: {', '.join(missing)}"
    assert (found["missing"], whole["missing"]) == (missing, [])
    assert found["failure"] == "interrupted" and found["press"]["stopped"] is None
    with np.load(out / "signals.npz") as mine, np.load(shallow / "signals.npz") as theirs:
        for key in ("height_m", "normals", "contact_mask"):
            np.testing.assert_array_equal(mine[key], theirs[key], err_msg=key)
    assert (out / "report.html").exists() == (moment == "coarser press")
    assert not [path for path in tmp_path.iterdir() if path != out]


@pytest.mark.thorough
def test_equal_presses_are_equal_to_the_byte(unit: Path, tmp_path: Path) -> None:
    """All files but that of the run's times."""
    outs = [tmp_path / name / "press" for name in "ab"]
    for out in outs:
        assert press(unit, out, f"--depth-mm 0.2 --states {QUICK}") == 0
    one, other = (
        {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.is_file()} for out in outs
    )
    differ = {str(name) for name in one | other if one.get(name) != other.get(name)}
    assert differ <= {"times.json", OUTPUT_MARKER}


@pytest.mark.thorough
def test_a_press_without_a_finished_step_leaves_the_earlier_one(
    unit: Path, shallow: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    def fail(self: PressEnv, *_: object) -> None:
        raise SimulationError("no luck at depth 0.2 mm")

    monkeypatch.setattr(PressEnv, "move_to", fail)
    before = everything_below(shallow.parent)
    for out in (shallow, shallow.with_name("new")):
        words = ("press", unit, "--out", out, "--depth-mm", "0.3", *QUICK.split())
        assert "simulation failed: no luck at depth 0.2 mm" in cli(*words, code=3).err
        assert everything_below(shallow.parent) == before


def test_a_part_in_metres_is_refused_with_its_sizes(unit: Path, tmp_path: Path, cli: Cli) -> None:
    """A puck of 60 mm as a speck of 0.06 mm, and a texture of 2 mm as one of 2 um."""
    puck, texture = tmp_path / "puck.stl", tmp_path / "t.png"
    pyvista.Cylinder(direction=(0, 0, 1), radius=0.03, height=0.01).save(puck)
    cv2.imwrite(str(texture), np.arange(64, dtype=np.uint8).reshape(8, 8))
    for options, words in (
        (
            f"--mesh focused --indenter mesh:{puck}",
            ("0.06 mm across", "60 mm if its numbers are metres", "1.524 mm"),
        ),
        (
            f"--texture {texture} --texture-mm 5e-5 2e-3",
            ("5e-05 mm", "0.05 mm if its numbers are metres"),
        ),
    ):
        bad = ("press", unit, "--out", tmp_path / "out", "--depth-mm", "0.02", *QUICK.split())
        told = cli.refusal(*bad, *options.split())
        assert all(word in told for word in words), told
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_press_writes_the_dots_where_its_picture_shows_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, fast)
    out, radius_px = tmp_path / "press", 0.35 / 0.0634
    options = "--depth-mm 0.6 --shear-mm 0.4 0 --accuracy fast --states --indenter sphere:3"
    assert press("gelsight_mini", out, options) == 0
    files = {path.name for path in out.iterdir()}
    assert files == FILES | PREDICTED | {"markers.csv", "markers.png", "states.npz"}
    with (out / "markers.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    table = np.array([[float(row["u_px"]), float(row["v_px"])] for row in rows])
    picture = cv2.imread(str(out / "predicted.png"))[..., ::-1]
    found = find_dots(picture, radius_px)
    assert len(found) == len(table) == 63
    off = distances_px(found, table)
    assert off.mean() < 0.25 and off.max() < 0.8
    values = read(out)["markers"]
    assert values["count"] == 63 and values["image_px"] == [320, 240]
    np.testing.assert_allclose(values["px"], table, atol=1e-3)
    assert values["largest_motion_px"] > 2
    with np.load(out / "signals.npz") as signals:
        np.testing.assert_allclose(signals["markers_px"], table, atol=1e-3)
        at_rest = signals["rest_markers_px"]
        sunk = signals["rest_height_m"] - signals["height_m"]
        mask = signals["contact_mask"]
    v, u = np.nonzero(mask)
    # The height map is of the picture's pixels: what touches lies where the picture changed.
    assert sunk[mask].mean() > 2e-4 and sunk[~mask].mean() < 1e-4
    assert u.mean() == pytest.approx(159.5 + 0.4 / 0.0634, abs=3.0)  # More of its lee touches.
    assert v.mean() == pytest.approx(119.5, abs=1.5)
    with np.load(out / "states.npz") as states:
        np.testing.assert_allclose(states["markers_px"][0], at_rest, atol=1e-9)
        np.testing.assert_allclose(states["markers_px"][-1], table, atol=1e-3)
        for row, image in enumerate(states["images"]):
            dots = find_dots(image, radius_px)
            assert distances_px(dots, states["markers_px"][row]).mean() < 0.25
