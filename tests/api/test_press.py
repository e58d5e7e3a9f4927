# SPDX-License-Identifier: Apache-2.0
"""``press``: one call from a script, with the command's defaults."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.api.press_options import PressOptions, PressWords
from taccel_lab.cli.press import Press as PressCommand

ROOT = Path(__file__).parents[2]
SCRIPT = """
import taccel_lab as tl
out = tl.press("flat_pad", "sphere:4", depth_mm=0.3, accuracy="fast", mesh="profile")
print(out.force_n)
"""


@pytest.fixture(scope="module")
def pressed() -> tl.Press:
    return tl.press("flat_pad", "sphere:4", depth_mm=0.3, accuracy="fast", mesh="profile")


def test_what_a_press_tells(pressed: tl.Press, tmp_path: Path) -> None:
    shape = pressed.plan.profile.grid().height_px, pressed.plan.profile.grid().width_px
    assert pressed.force_n > 0 and pressed.force_error_n > 0
    assert pressed.wrench[2] == pressed.force_n
    assert pressed.height_mm.shape == pressed.contact_mask.shape == shape
    assert np.nanmax(pressed.depth_mm) == pytest.approx(0.3, abs=0.01)
    assert pressed.image is not None and pressed.image.dtype == np.uint8
    assert pressed.image.shape == (*shape, 3)
    assert pressed.markers is None
    text = repr(pressed)
    assert text.startswith("sphere:4 pressed 0.3 mm into flat_pad\n")
    assert f"{pressed.force_n:.4g}" in text and len(text.splitlines()) < 12
    assert "<table>" in pressed._repr_html_() and len(pressed.plot().axes) >= 3
    pressed.save(tmp_path / "out")
    assert {"press.json", "scene.png", "image.png", "signals.npz", "gel.vtu"} - {
        path.name for path in (tmp_path / "out").iterdir()
    } <= {"image.png"}


def test_the_deepest_place_is_that_of_the_contact(
    pressed: tl.Press, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A ray that grazes a dome's border finds a large depth there, without any contact."""
    told = dict(pressed.summary()[1])["deepest"]
    grazed = pressed.depth_mm.copy()
    grazed[0, 0] = 9.0
    assert not pressed.contact_mask[0, 0]
    monkeypatch.setattr(type(pressed), "depth_mm", property(lambda _: grazed))
    assert dict(pressed.summary()[1])["deepest"] == told


def test_a_profile_and_its_name_press_alike(pressed: tl.Press) -> None:
    profile = tl.load_sensor("flat_pad")
    again = tl.press(profile, "sphere:4", depth_mm=0.3, accuracy="fast", mesh="profile")
    assert again.force_n == pytest.approx(pressed.force_n, rel=1e-6)
    # Friction is the profile's unless another one is given.
    assert again.plan.friction == profile.material.friction_coefficient > 0


def test_a_press_with_its_files_loads_neither_torch_nor_vtk(tmp_path: Path) -> None:
    """They took longer to load than the press took to solve."""
    heavy = ("torch", "pyvista", "vtkmodules", "build123d", "OCP")
    loaded = f"import sys\nprint({{*{heavy!r}}} & {{*sys.modules}})"
    code = f"out.save({str(tmp_path / 'out')!r})\n{loaded}"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT + code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "set()"


def test_the_command_has_the_same_options_and_defaults() -> None:
    assert issubclass(PressCommand, PressOptions)
    fields = {field.name for field in dataclasses.fields(PressOptions)}
    assert set(PressWords.__annotations__) == fields - {"indenter"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "one of --depth-mm, --force-n and --like"),
        ({"depth_mm": 0.3, "force_n": 1.0}, "one of --depth-mm, --force-n and --like"),
        ({"depth_mm": 9.0}, "goes past the gel"),
        ({"depth_mm": 0.3, "accuracy": "best"}, "accuracy 'best' is not known; allowed: fast"),
        ({"depth_mm": 0.3, "element": "cubic"}, "element 'cubic' is not known"),
        ({"depth_mm": 0.3, "friction": -1.0}, "--friction"),
        ({"depth_mm": 0.3, "device": "tpu"}, "device 'tpu' is not there"),
    ],
)
def test_what_cannot_be_pressed_is_refused(words: dict, message: str) -> None:
    with pytest.raises(tl.InputError, match=message):
        tl.press("flat_pad", "sphere:4", **words)


def test_a_checkout_without_links_presses_from_a_plain_script(tmp_path: Path) -> None:
    """As on Windows: links are files that hold where they lead. Nothing is printed but by the
    script, which has no main guard."""
    if not (ROOT / ".git").exists():
        pytest.skip("no git checkout: an sdist has no links")
    tree = tmp_path / "tree"
    subprocess.run(
        ["git", "-c", "core.symlinks=false", "checkout-index", "--all", f"--prefix={tree}/"],
        cwd=ROOT,
        check=True,
    )
    assert (tree / "taccel_lab" / "cad").is_file()
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        env=os.environ | {"PYTHONPATH": str(tree)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    (line,) = done.stdout.splitlines()
    assert 0.01 < float(line) < 10
