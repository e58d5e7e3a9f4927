# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab press`` from the command line to the files it leaves."""

from __future__ import annotations

import csv
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import pyvista

from taccel_lab.cli.app import main
from taccel_lab.errors import SimulationError
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.presses import PHYSICS, Accuracy
from taccel_lab.presses.press_env import PressEnv
from taccel_lab.profile import load_profile, save_profile
from taccel_lab.profile.schema import BranchEntry
from taccel_lab.scene import Element
from taccel_lab.solvers import StepReport
from tests.geometry.vtu_files import read_mesh_vtu
from tests.signals.find_dots import distances_px, find_dots
from tests.support.small_captures import everything_below, write_profile

FILES = {
    OUTPUT_MARKER,
    "contact_pressure.png",
    "force_depth.png",
    "gel.vtu",
    "height_map.png",
    "normals.png",
    "scene.png",
    "press.json",
    "times.json",
    "signals.npz",
}
PREDICTED = {"predicted.png"}
"""Of a sensor without colour model whose optics are known."""
QUICK = ("--accuracy", "fast", "--friction", "0")


def quicken(patch: pytest.MonkeyPatch) -> None:
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    patch.setitem(PHYSICS, Accuracy.FAST, fast)
    patch.setattr("taccel_lab.presses.press_files.PREDICTED_PX", 64)


@pytest.fixture(autouse=True)
def small_pictures_and_quick_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    quicken(monkeypatch)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A GelSight without colour model whose pictures are small."""
    return write_profile(tmp_path_factory.mktemp("unit") / "unit", color=False)


@pytest.fixture(scope="module")
def shallow(unit: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a press of 0.2 mm, quick as those of the tests."""
    out = tmp_path_factory.mktemp("shallow") / "press"
    with pytest.MonkeyPatch.context() as patch:
        quicken(patch)
        assert press(unit, out, "--depth-mm", "0.2", *QUICK) == 0
    return out


@pytest.fixture
def earlier(shallow: Path, tmp_path: Path) -> Path:
    """The same press in a folder of the test's own."""
    return shutil.copytree(shallow, tmp_path / "press")


def press(sensor: object, out: Path, *options: str) -> int:
    return main(["press", str(sensor), "--out", str(out), *options])


def read(out: Path) -> dict[str, Any]:
    return json.loads((out / "press.json").read_text())


def check_press_figures(values: dict[str, Any], steps: int) -> None:
    figures = values["press"]
    assert figures["force_n"] > 0
    assert figures["force_n"] == figures["wrench"]["force_n"][2]
    assert 0 <= figures["residual_n"] <= 1e-4 * figures["contact_force_sum_n"]
    assert figures["newton_iterations"] >= steps
    assert 0 < figures["min_distance_m"] < 2e-5
    assert figures["smallest_volume_ratio"] > 0
    assert figures["step_count"] == len(figures["steps"]) == steps


@pytest.mark.thorough
@pytest.mark.rasterised
def test_press_on_a_sensor_of_the_catalogue(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "deep" / "press"
    options = ["--depth-mm", "0.4", "--at-mm", "1.0", "-0.5", "--shear-mm", "0.1", "0"]
    assert press("gelsight", out, *options, "--twist-deg", "2", "--accuracy", "fast") == 0
    assert {path.name for path in out.iterdir()} == FILES | PREDICTED
    assert cv2.imread(str(out / "predicted.png")).shape == (48, 64, 3)
    assert os.listdir(out.parent) == ["press"]
    values = read(out)
    check_press_figures(values, 3)
    assert values["sensor"] == "gelsight"
    assert values["indenter"] == "sphere:2.0"
    assert values["at_mm"] == [1.0, -0.5]
    assert values["path"] == {"depth_mm": 0.4, "shear_mm": [0.1, 0.0], "twist_deg": 2.0}
    assert values["friction_coefficient"] == 1.0
    assert values["material"] == {"young_modulus_pa": 150000.0, "poisson_ratio": 0.46}
    assert values["press"]["wrench"]["force_n"][0] < 0
    assert values["indenter_pose"][:2] == pytest.approx([1.1e-3, -0.5e-3])
    captured = capsys.readouterr()
    assert captured.out == ""
    for words in ("force of the gel on the indenter", "smallest gap", "wrote"):
        assert words in captured.err

    with np.load(out / "signals.npz") as signals:
        assert set(signals.files) == {
            "height_m", "rest_height_m", "normals", "rest_normals", "contact_mask",
            "contact_forces_n",
            "contact_pressures_pa",
        }  # fmt: skip
        assert signals["height_m"].shape == signals["contact_mask"].shape == (480, 640)
        assert signals["normals"].shape == (480, 640, 3)
        v, u = np.unravel_index(
            np.nanargmin(signals["height_m"] - signals["rest_height_m"]), (480, 640)
        )
        assert (u - 319.5) * 0.0295 == pytest.approx(1.1, abs=0.2)
        assert (v - 239.5) * 0.0295 == pytest.approx(-0.5, abs=0.2)
        total = signals["contact_forces_n"].sum(axis=0)
    assert total == pytest.approx(-np.array(values["press"]["wrench"]["force_n"]), rel=1e-6)
    mesh = read_mesh_vtu(out / "gel.vtu")
    assert mesh.node_count == values["mesh"]["node_count"]
    assert mesh.tet_count == values["mesh"]["tet_count"]
    for name in FILES:
        if name.endswith(".png"):
            image = cv2.imread(str(out / name))
            assert image is not None and image.std() > 5, name


@pytest.mark.thorough
def test_equal_presses_write_equal_figures(unit: Path, shallow: Path, tmp_path: Path) -> None:
    assert press(unit, tmp_path / "again", "--depth-mm", "0.2", *QUICK) == 0
    for name in ("press.json", "gel.vtu", "signals.npz"):
        assert (tmp_path / "again" / name).read_bytes() == (shallow / name).read_bytes(), name
    times = json.loads((shallow / "times.json").read_text())
    assert times["seconds"] > sum(times["step_seconds"]) > 0


@pytest.mark.thorough
def test_a_texture_shows_in_the_heights(
    unit: Path, shallow: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same press with and without ridges along y, 0.5 mm apart."""
    ridges = np.tile(np.array([0, 0, 255, 255], dtype=np.uint8), (4, 1))
    cv2.imwrite(str(tmp_path / "ridges.png"), ridges)
    common = ["--depth-mm", "0.2", *QUICK]
    texture = ["--texture", str(tmp_path / "ridges.png"), "--texture-mm", "0.02", "0.5"]
    assert press(unit, tmp_path / "ridged", *common, *texture) == 0
    smooth, ridged = read(shallow), read(tmp_path / "ridged")
    assert smooth["texture"] is None and smooth["press"]["fine_force_n"] is None
    assert ridged["texture_mm"] == [0.02, 0.5]
    # The mean surface is 10 um higher.
    assert 0.85 < ridged["press"]["force_n"] / smooth["press"]["force_n"] < 0.99
    assert 0.7 < ridged["press"]["fine_force_n"] / ridged["press"]["force_n"] < 1.2
    bends = []
    for folder in (shallow, tmp_path / "ridged"):
        with np.load(folder / "signals.npz") as signals:
            height, mask = signals["height_m"], signals["contact_mask"]
        bends.append(np.abs(np.diff(height, 2, axis=1))[mask[:, 1:-1]].mean())
    assert bends[1] > 1.5 * bends[0]
    missing = ["--texture", str(tmp_path / "none.png")]
    assert press(unit, tmp_path / "bad", *common, *missing) == 2
    assert "none.png" in capsys.readouterr().err
    assert press(unit, tmp_path / "bad", "--depth-mm", "0.005", *QUICK, *texture) == 2
    assert "press deeper" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "bad").exists()


@pytest.mark.thorough
def test_a_press_to_a_force_is_one_to_its_depth(unit: Path, tmp_path: Path) -> None:
    assert press(unit, tmp_path / "force", "--force-n", "0.6", *QUICK) == 0
    found = read(tmp_path / "force")
    assert found["asked_force_n"] == 0.6
    assert found["press"]["force_n"] == pytest.approx(0.6, rel=0.01)
    depth = repr(found["path"]["depth_mm"])
    assert press(unit, tmp_path / "depth", "--depth-mm", depth, *QUICK) == 0
    again = read(tmp_path / "depth")
    assert again["asked_force_n"] is None
    assert again["press"]["wrench"] == found["press"]["wrench"]
    assert again["mesh"] == found["mesh"]


@pytest.mark.thorough
def test_a_hold_and_a_way_back_are_told(
    unit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    profile = load_profile(unit)
    soft = profile.material.replace(branches=(BranchEntry(relative_modulus=0.5, time_s=1.0),))
    save_profile(profile.with_block(soft), tmp_path / "soft")
    path = ["--depth-mm", "0.2", "--hold-s", "3", "--unload"]
    assert press(tmp_path / "soft", tmp_path / "out", *path, *QUICK) == 0
    shown, found = capsys.readouterr().err, read(tmp_path / "out")["press"]
    assert found["hold"]["to_n"] < 0.9 * found["hold"]["from_n"]
    assert f"{found['hold']['from_n']:.4g}  {found['hold']['to_n']:.4g}" in shown
    assert f"{found['loop']['work_mj']:.4g}  {found['loop']['lost_mj']:.4g}" in shown
    rows = [line.split() for line in shown.splitlines() if "past first touch" in line]
    assert [row[-2] for row in rows] == ["0.2", "0"]


@pytest.mark.thorough
def test_options_reach_the_solver(unit: Path, tmp_path: Path) -> None:
    common = ["--depth-mm", "0.3", "--friction", "0", "--step-mm", "0.1", "--accuracy", "fast"]
    assert press(unit, tmp_path / "a", *common) == 0
    assert press(unit, tmp_path / "b", *common, "--tolerance", "1e-7", "--dhat-mm", "0.05") == 0
    a, b = (read(tmp_path / name)["press"] for name in "ab")
    assert a["step_count"] == 3
    # The absolute tolerance of 1e-7 N is always good enough.
    assert b["residual_n"] <= 1e-7 < a["residual_n"] <= 1e-4 * a["contact_force_sum_n"]
    assert a["min_distance_m"] < 2e-5 < b["min_distance_m"] < 5e-5


@pytest.mark.thorough
def test_a_press_that_fails_leaves_the_earlier_one(
    unit: Path,
    earlier: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = everything_below(tmp_path)

    def fail(self: PressEnv, *_: object) -> None:
        raise SimulationError("no luck at depth 0.2 mm")

    monkeypatch.setattr(PressEnv, "move_to", fail)
    assert press(unit, earlier, "--depth-mm", "0.3", *QUICK) == 3
    assert "simulation failed: no luck at depth 0.2 mm" in capsys.readouterr().err
    assert everything_below(tmp_path) == before
    assert press(unit, tmp_path / "new", "--depth-mm", "0.3", *QUICK) == 3
    assert everything_below(tmp_path) == before


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("error", "code"),
    [pytest.param(SimulationError("stuck"), 3, marks=pytest.mark.slow), (KeyboardInterrupt(), 130)],
)
def test_finished_steps_are_kept(
    unit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    """A press that stops in its third step is the one that ends with its second, and says so."""
    options = ("--step-mm", "0.1", "--mesh", "profile", "--states", *QUICK, "--friction", "0.5")
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert press(unit, whole, "--depth-mm", "0.2", *options) == 0
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
    assert press(unit, out, "--depth-mm", "0.4", *options) == code
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
    assert press(unit, whole, "--depth-mm", "0.4", *options) == code
    assert (everything_below(whole) == before) == (code == 130)


@pytest.mark.parametrize("options", [("--mesh", "focused"), ("--texture",)])
def test_a_part_in_metres_is_refused_with_its_sizes(
    unit: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]
) -> None:
    """A puck of 60 mm as a speck of 0.06 mm, and a texture of 2 mm as one of 2 um."""
    if options == ("--texture",):
        cv2.imwrite(str(tmp_path / "t.png"), np.arange(64, dtype=np.uint8).reshape(8, 8))
        options = ("--texture", str(tmp_path / "t.png"), "--texture-mm", "5e-5", "2e-3")
        words = ("5e-05 mm", "0.05 mm if its numbers are metres")
    else:
        puck = tmp_path / "puck.stl"
        pyvista.Cylinder(direction=(0, 0, 1), radius=0.03, height=0.01).save(puck)
        options = (*options, "--indenter", f"mesh:{puck}")
        words = ("0.06 mm across", "60 mm if its numbers are metres", "1.524 mm")
    assert press(unit, tmp_path / "out", "--depth-mm", "0.02", *options, *QUICK) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert all(word in told for word in words), told
    assert not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_an_interrupted_press_leaves_nothing(
    unit: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    # While the files are being written, after the press.
    monkeypatch.setattr("taccel_lab.presses.press_files.write_mesh_vtu", interrupt)
    assert press(unit, tmp_path / "a" / "press", "--depth-mm", "0.2", *QUICK) == 130
    assert everything_below(tmp_path) == {}


@pytest.mark.slow
def test_press_writes_the_dots_where_its_picture_shows_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    fast = replace(PHYSICS[Accuracy.FAST], element=Element.LINEAR)
    monkeypatch.setitem(PHYSICS, Accuracy.FAST, fast)
    out, radius_px = tmp_path / "press", 0.35 / 0.0634
    options = ["--depth-mm", "0.6", "--shear-mm", "0.4", "0", "--accuracy", "fast", "--states"]
    assert press("gelsight_mini", out, *options, "--indenter", "sphere:3") == 0
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
