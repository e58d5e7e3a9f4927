# SPDX-License-Identifier: Apache-2.0
"""Sensors, presses and photos of presses from Python."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import build123d as bd
import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.cad.mesh.gel_mesh import kept_mesh, sound_gel_mesh
from taccel_lab.cli.press import PressCommand
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.options import PressOptions
from taccel_lab.processes.process_pool import usable_cores
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.with_error import with_error


@pytest.mark.thorough
def test_a_catalogue_name_with_parameters():
    profile = tl.load_sensor("flat_pad", thickness_mm=3)
    assert profile.gel.thickness_mm == pytest.approx(3)
    text = repr(profile)
    assert text.startswith("profile of flat_pad\n") and "3 mm thick" in text
    assert len(text.splitlines()) < 25 and max(map(len, text.splitlines())) <= 110
    assert "<caption><b>profile of flat_pad</b></caption>" in profile._repr_html_()


def test_the_folder_of_a_profile(tmp_path):
    tl.save_profile(tl.load_sensor("flat_pad"), tmp_path / "profile")
    assert repr(tl.load_sensor(tmp_path / "profile")) == repr(tl.load_sensor("flat_pad"))
    for changed in (tmp_path / "profile", tl.load_sensor(tmp_path / "profile")):
        with pytest.raises(tl.InputError, match="thickness_mm: only sensors of the catalogue"):
            tl.load_sensor(changed, thickness_mm=3)


@pytest.mark.thorough
def test_a_step_file(tmp_path):
    file, top = tmp_path / "gel.step", ("plane:+z",)
    bd.export_step(bd.Box(16, 12, 3), str(file))
    faces = {"contact": top, "bond": ("plane:-z",), "window": ("rect:10x8",)}
    profile = tl.load_sensor(file, young_modulus_mpa=0.2, **faces)
    assert profile.gel.thickness_mm == pytest.approx(3)
    assert profile.material.young_modulus_pa == pytest.approx(2e5)
    with pytest.raises(tl.InputError, match=r"takes no option 'contacts' \(did you mean contact"):
        tl.load_sensor(file, contacts=top)
    with pytest.raises(tl.InputError, match="no parameter 'contact'"):
        tl.load_sensor("flat_pad", contact=top)


@pytest.mark.thorough
def test_the_designed_mesh_is_kept_between_runs(tmp_path, monkeypatch):
    pad = sensor_family("gelsight_mini").parameters().pad()
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    made, quality, edge_mm = kept_mesh(pad, sound_gel_mesh)
    kept, *about = kept_mesh(pad, lambda _: pytest.fail("made again"))
    assert about == [quality, edge_mm]
    for name in ("nodes_m", "tets", "faces", "face_regions", "tet_layers"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(made, name))
    other = replace(pad, thickness_mm=pad.thickness_mm - 0.1)
    assert kept_mesh(other, lambda _: (made, quality, 0.5))[2] == 0.5
    # Without a folder that can be written it is made each time.
    monkeypatch.setenv(CACHE_VARIABLE, "/dev/null/cache")
    assert kept_mesh(pad, lambda _: (made, quality, 0.7))[2] == 0.7


QUICK = {"depth_mm": 0.3, "accuracy": "fast", "element": "linear"}
"""A fast press solves in a second; one on the stored mesh takes twenty times as long."""


@pytest.fixture(scope="module")
def pressed():
    return tl.press("flat_pad", "sphere:4", **QUICK)


@pytest.mark.thorough
def test_nobody_has_measured_a_stored_mesh():
    small = tl.load_sensor("flat_pad", thickness_mm=8, length_x_mm=12, length_y_mm=10)
    pressed = tl.press(small, "sphere:4", **QUICK, mesh="profile")
    assert np.isnan(pressed.force_error_n) and "nan" not in repr(pressed)
    low, high = pressed.force_interval_n
    assert low < 0.6 * pressed.force_n and high > 1.9 * pressed.force_n, "of any modulus"


@pytest.mark.thorough
def test_what_a_press_says(pressed, tmp_path, monkeypatch):
    profile = pressed.plan.profile
    shape = profile.grid().height_px, profile.grid().width_px
    assert pressed.force_n == pressed.wrench[2] > 0 < pressed.force_error_n
    # Friction is the profile's unless another one is given.
    assert pressed.plan.friction == profile.material.friction_coefficient > 0
    assert pressed.height_m.shape == pressed.contact_mask.shape == shape
    assert pressed.depth_mm == pytest.approx(0.3, abs=0.01)
    assert pressed.center_mm == pytest.approx((0.0, 0.0), abs=0.02)
    assert pressed.image.dtype == np.uint8 and pressed.image.shape == (*shape, 3)
    assert pressed.markers is None
    text = repr(pressed)
    assert text.startswith("sphere:4 pressed 0.3 mm into flat_pad\n")
    assert f"{with_error(pressed.force_n, pressed.force_error_n)} N" in text
    assert len(text.splitlines()) < 12
    assert "<table>" in pressed._repr_html_() and len(pressed.plot().axes) >= 3
    pressed.save(tmp_path / "out")
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"press.json", "scene.png", "signals.npz", "gel.vtu"} <= written
    # The deepest place is that of the contact: a ray that grazes a dome's border finds a large
    # depth there, without any.
    deepest, grazed = dict(pressed.summary()[1])["depth"], pressed.depth_m.copy()
    grazed[0, 0] = 9e-3
    assert not pressed.contact_mask[0, 0]
    monkeypatch.setattr(type(pressed), "depth_m", property(lambda _: grazed))
    assert dict(pressed.summary()[1])["depth"] == deepest


def test_the_command_has_the_same_options_and_defaults():
    assert issubclass(PressCommand, PressOptions)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "one of --depth-mm, --force-n and --like"),
        ({"depth_mm": 0.3, "force_n": 1.0}, "one of --depth-mm, --force-n and --like"),
        ({"depth_mm": 9.0}, "goes past the gel"),
        ({"depth_mm": 0.3, "accuracy": "best"}, "accuracy 'best' is not known; allowed: fast"),
        ({"depth_mm": 0.3, "accuracy": "3%", "mesh": "profile"}, "leave out --mesh and --element"),
        ({"depth_mm": 0.3, "accuracy": "3%", "levels": 5}, r"--levels must lie in \[0, 4\]"),
        (
            {"depth_mm": 0.3, "element": "cubic"},
            "element must be 'linear' or 'quadratic' or",
        ),
        ({"depth_mm": 0.3, "friction": -1.0}, "--friction"),
        ({"depth_mm": 0.3, "device": "tpu"}, "device 'tpu' is not there"),
    ],
)
def test_what_cannot_be_pressed_is_refused(words, message):
    with pytest.raises(tl.InputError, match=message):
        tl.press("flat_pad", "sphere:4", **words)


@pytest.mark.slow
def test_a_percentage_is_kept_against_the_closed_form():
    """Small strains, no friction: the exact linear solution is within 1 % of the truth there."""
    found = tl.press("flat_pad", "sphere:4", depth_mm=0.1, friction=0.0, accuracy="3%")
    assert found.error.shortfall is None
    profile = found.plan.profile
    law = (profile.gel.thickness_mm, profile.material.poisson_ratio)
    modulus = profile.material.young_modulus_pa
    exact = layer_force_n("sphere", np.array([0.1]), 4.0, *law, modulus)[0]
    assert 0 < found.force_error_n <= 0.03 * found.force_n
    assert abs(found.force_n - exact) <= found.force_error_n + 0.01 * exact
    errors = found.figures()["errors"]
    assert errors["measured"]["share"] <= 0.03
    assert errors["force_n"]["numerical"] == found.force_error_n


ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "pyvista", "vtkmodules", "build123d", "OCP")
"""They took longer to load than the press took to solve."""
DRAWING = ("matplotlib", "PIL", "cv2")


def loaded_by(code: str, *names: str) -> str:
    """Those of ``names`` that a process has loaded after ``code``."""
    script = f"{code}\nimport sys\nprint({{*{names!r}}} & {{*sys.modules}})"
    options = {"cwd": ROOT, "capture_output": True, "text": True, "check": True}
    return subprocess.run([sys.executable, "-c", script], **options).stdout.splitlines()[-1]


@pytest.mark.thorough
@pytest.mark.skipif(usable_cores() < 2, reason="on one core the command draws itself")
def test_the_command_draws_in_a_process_beside(tmp_path):
    words = "press flat_pad --depth-mm 0.2 --accuracy fast --element linear --out".split()
    code = f"from taccel_lab.cli.app import main\nmain({[*words, str(tmp_path / 'out')]!r})"
    assert loaded_by(code, *HEAVY, "matplotlib") == "set()"
    assert (tmp_path / "out" / "height_map.png").exists()


KERNELS = ("taccel_lab.ipc", "taccel_lab.model.model", "taccel_lab.solvers.solver_ipc")


@pytest.mark.thorough(cases=("sensors.profile", "presses.run"))
@pytest.mark.parametrize(
    "module", ["presses.scene_picture", "report.figures", "sensors.profile", "presses.run"]
)
def test_what_draws_or_plans_loads_no_solver(module):
    absent = KERNELS if module == "presses.run" else (*DRAWING, "warp")
    assert loaded_by(f"import taccel_lab.{module}", *HEAVY, *absent, "scipy") == "set()"


@pytest.mark.thorough
def test_a_press_on_the_cpu_loads_no_linear_solver_of_gpus():
    cpu, *methods = (f"taccel_lab.ipc.linear.{n}" for n in ("cpu", "arrow.solver", "cg.block_cg"))
    options = "depth_mm=0.2, accuracy='fast', element='linear'"
    code = f"from taccel_lab import press\npress('flat_pad', {options})"
    assert loaded_by(code, *methods, cpu) == f"{{'{cpu}'}}"


SCRIPT = """
import sys
import taccel_lab as tl
out = tl.press("flat_pad", "sphere:4", depth_mm=0.3, accuracy="fast", element="linear")
print(out.force_n)
print({"matplotlib", "PIL", "cv2"} & {*sys.modules})
out.save("out")
print({"torch", "pyvista", "vtkmodules", "build123d", "OCP"} & {*sys.modules})
"""


@pytest.mark.thorough
def test_a_checkout_without_links_presses_from_a_plain_script(tmp_path):
    """As on Windows: links are files that hold where they lead. Nothing is printed but by the
    script, which has no main guard; the press and its files load neither torch nor vtk."""
    if not (ROOT / ".git").exists():
        pytest.skip("no git checkout: an sdist has no links")
    tree = tmp_path / "tree"
    out = ["checkout-index", "--all", f"--prefix={tree}/"]
    subprocess.run(["git", "-c", "core.symlinks=false", *out], cwd=ROOT, check=True)
    assert (tree / "taccel_lab" / "cad").is_file()
    (tmp_path / "script.py").write_text(SCRIPT)
    options = {"env": os.environ | {"PYTHONPATH": str(tree)}, "cwd": tmp_path}
    words = [sys.executable, str(tmp_path / "script.py")]
    done = subprocess.run(words, **options, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    force, drawing, heavy = done.stdout.splitlines()
    assert 0.01 < float(force) < 10
    assert drawing == heavy == "set()" and (tmp_path / "out" / "scene.png").is_file()
