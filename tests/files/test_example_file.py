# SPDX-License-Identifier: Apache-2.0
"""Examples by name, from any folder: who installed a wheel has no path to them."""

from __future__ import annotations

from pathlib import Path

import pytest

import taccel_lab
from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import file_or_example

ROOT = Path(__file__).parents[2] / "taccel_lab"


@pytest.mark.parametrize("folder", ["", "{room}/examples/", "taccel_lab/{room}/examples/"])
@pytest.mark.parametrize("ending", ["", ".toml"])
@pytest.mark.parametrize(
    ("room", "name"), [("studies", "mini_thickness_hardness"), ("datasets", "mini_touches")]
)
def test_a_name_is_that_of_an_example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: str, name: str, ending: str, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    found = file_or_example(Path(folder.format(room=room) + name + ending), room)
    assert found.samefile(ROOT / room / "examples" / f"{name}.toml")


def test_a_file_comes_before_an_example_and_a_folder_hides_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "insertion.toml").touch()
    (tmp_path / "other").mkdir()
    others = ("insertion.toml", tmp_path / "softest_gel.toml", "mine/softest_gel", "other")
    for path in map(Path, others):
        assert file_or_example(path, "studies") == path
    monkeypatch.chdir(tmp_path / "other")
    Path("insertion").mkdir()
    assert file_or_example(Path("insertion"), "studies").parent == ROOT / "studies" / "examples"
    with pytest.raises(InputError, match=r"mini_touch does not exist.*known: force_mini, mini_to"):
        file_or_example(Path("mini_touch"), "datasets")


def test_scripts_name_examples_as_commands_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no example has that name \(did you mean softest_gel"):
        taccel_lab.study("softest_gal", tmp_path)
