# SPDX-License-Identifier: Apache-2.0
"""All our modules are taccel_lab's own: a user's sensors.py or calibration.py does no harm."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = sorted(link.name for link in (ROOT / "taccel_lab").iterdir() if link.is_symlink())
SCRIPT = """
import importlib, sys
import {names}
import taccel_lab
from taccel_lab.cli.app import main
for package in {names!r}.split(", "):
    found = importlib.import_module("taccel_lab." + package)
    assert found.__file__.startswith({root!r}), found.__file__
    assert sys.modules[package].MINE == "the user's own"
main(["sensors", "list", "--json"])
"""


def run_beside_the_users_own_modules(folder: Path, root: Path) -> str:
    """A script in a folder that has a module named like each of our packages."""
    for package in PACKAGES:
        (folder / f"{package}.py").write_text('MINE = "the user\'s own"\n')
    script = folder / "my_script.py"
    script.write_text(SCRIPT.format(names=", ".join(PACKAGES), root=str(root)))
    done = subprocess.run(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(root)])},
        capture_output=True,
        text=True,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_folder_at_the_top_is_a_part_of_the_package() -> None:
    assert PACKAGES == ["benchmarks", "cad", "calibration", "cli"] + [
        "datasets",
        "learning",
        "robots",
        "sensors",
        "studies",
        "tasks",
        "viewer",
    ]
    for package in PACKAGES:
        assert (ROOT / "taccel_lab" / package).resolve() == ROOT / package


def test_a_users_own_modules_do_no_harm_to_a_checkout(tmp_path: Path) -> None:
    assert "gelsight_mini" in run_beside_the_users_own_modules(tmp_path, ROOT)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's files, unpacked."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder / "unpacked")
    return folder / "unpacked"


def test_the_wheel_installs_one_name(wheel: Path) -> None:
    names = {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"}
    assert names == {"taccel_lab"}
    for package in PACKAGES:
        ours = {str(p.relative_to(ROOT / package)) for p in (ROOT / package).rglob("*.py")}
        assert ours == {
            str(p.relative_to(wheel / "taccel_lab" / package))
            for p in (wheel / "taccel_lab" / package).rglob("*.py")
        }
    assert not list(wheel.rglob("test_*.py"))
    for files in ("robots/models", "tasks/files", "calibration/capture/importers/recipes"):
        ours = {path.name for path in (ROOT / files).iterdir()}
        assert ours == {path.name for path in (wheel / "taccel_lab" / files).iterdir()}


def test_a_users_own_modules_do_no_harm_to_an_installed_wheel(wheel: Path, tmp_path: Path) -> None:
    assert "gelsight_mini" in run_beside_the_users_own_modules(tmp_path, wheel)
