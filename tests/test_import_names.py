# SPDX-License-Identifier: Apache-2.0
"""All our modules are taccel_lab's own: a user's sensors.py or calibration.py does no harm."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("cad", "calibration", "sensors")
"""They stand at the top of a checkout; links in the package lead to them."""
PACKAGES = (*ROOMS, "benchmarks", "cli", "datasets", "learning", "robots", "studies", "tasks")
"""What a user's own modules are likely to be called, too."""
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
    return run(script, cwd=folder, env=os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{root}"})


def run(*words: object, **options: Any) -> str:
    """What this Python prints."""
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_three_rooms_at_the_top_are_parts_of_the_package() -> None:
    links = sorted(path for path in (ROOT / "taccel_lab").iterdir() if path.is_symlink())
    assert [link.name for link in links] == list(ROOMS)
    assert [link.resolve() for link in links] == [ROOT / name for name in ROOMS]


@pytest.mark.thorough
def test_a_users_own_modules_do_no_harm_to_a_checkout(tmp_path: Path) -> None:
    assert "gelsight_mini" in run_beside_the_users_own_modules(tmp_path, ROOT)


def build(checkout: Path, folder: Path, target: str) -> Path:
    """An archive of a checkout, unpacked."""
    run("-m", "hatchling", "build", "-t", target, "-d", folder, cwd=checkout)
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        assert len(archive.namelist()) == len(set(archive.namelist()))
        archive.extractall(folder / "unpacked")
    return folder / "unpacked"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel's files, unpacked."""
    return build(ROOT, tmp_path_factory.mktemp("wheel"), "wheel")


def names(folder: Path) -> set[str]:
    """Files below a folder, links followed, without what Python leaves there."""
    return {
        str((Path(place) / file).relative_to(folder))
        for place, _, files in os.walk(folder, followlinks=True)
        for file in files
        if "__pycache__" not in place
    }


@pytest.mark.thorough
def test_the_wheel_installs_one_name(wheel: Path) -> None:
    top = {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"}
    assert top == {"taccel_lab"}
    assert names(wheel / "taccel_lab") == names(ROOT / "taccel_lab")
    assert not list(wheel.rglob("test_*.py"))


@pytest.mark.thorough
@pytest.mark.parametrize("links", ["text", "none"])
def test_the_wheel_of_a_checkout_without_links_is_whole(
    wheel: Path, tmp_path: Path, links: str
) -> None:
    """Windows checks a link out as a file that holds its target; some archives drop it."""
    checkout = tmp_path / "checkout"
    for name in ("taccel_lab", *ROOMS):
        left_out = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, checkout / name, symlinks=True, ignore=left_out)
    for name in ROOMS:
        link = checkout / "taccel_lab" / name
        link.unlink()
        if links == "text":
            link.write_text(f"../{name}")
    (checkout / "tools").mkdir()
    for name in ("pyproject.toml", "tools/wheel_rooms.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, checkout / name)
    found = build(checkout, tmp_path / "dist", "wheel")
    assert names(found / "taccel_lab") == names(wheel / "taccel_lab")


@pytest.mark.thorough
def test_an_editable_installation_gives_one_name(tmp_path: Path) -> None:
    site = build(ROOT, tmp_path, "wheel:editable")
    assert not (site / "taccel_lab").exists(), "a copy would hide what is edited"
    code = f"""
import importlib.util, site, sys
site.addsitedir({str(site)!r})
for name in ("benchmarks", "cad", "calibration", "datasets", "sensors", "tasks", "tests"):
    assert importlib.util.find_spec(name) is None, name
print(importlib.util.find_spec("taccel_lab.cad.parameters").origin)
"""
    # Neither this environment's own editable installation nor the checkout is on the path.
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    spec = importlib.util.find_spec("editables")
    assert spec is not None and spec.origin is not None
    shutil.copytree(Path(spec.origin).parent, site / "editables")
    assert run("-S", "-I", "-c", code, cwd=folder).strip() == str(
        ROOT / "taccel_lab" / "cad" / "parameters.py"
    )


@pytest.mark.thorough
def test_a_users_own_modules_do_no_harm_to_an_installed_wheel(wheel: Path, tmp_path: Path) -> None:
    assert "gelsight_mini" in run_beside_the_users_own_modules(tmp_path, wheel)
