# SPDX-License-Identifier: Apache-2.0
"""What there is to look at is known by its content, and refused with what would be needed."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from taccel_lab.cli.app import main
from taccel_lab.errors import InputError
from taccel_lab.viewer.sources import Kind, find_source


@pytest.mark.parametrize(
    ("files", "kind"),
    [
        (["press.json"], Kind.PRESS),
        (["dataset.json"], Kind.DATASET),
        (["replay.json", "film.mp4"], Kind.REPLAY),
        (["profile.toml"], Kind.PROFILE),
        ([".taccel_lab_study"], Kind.STUDY),
        (["designs/1/result.json"], Kind.STUDY),
    ],
)
def test_folders_are_known_by_a_file(tmp_path: Path, files: list[str], kind: Kind) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("{}")
    found = find_source(str(tmp_path))
    assert (found.kind, found.path) == (kind, tmp_path)


def test_the_profile_of_a_design_is_found_in_it(tmp_path: Path) -> None:
    (tmp_path / "profile").mkdir()
    (tmp_path / "profile" / "profile.toml").write_text("")
    assert find_source(str(tmp_path)).path == tmp_path / "profile"


def test_names_are_sensors_and_tasks() -> None:
    assert find_source("gelsight_mini").kind is Kind.PROFILE
    assert find_source("ball-rolling").kind is Kind.TASK


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ([], "nothing that can be looked at"),
        (["result.json"], "task record TASK --states"),
        (["trial.json", "film.mp4"], "record it again with --states"),
    ],
)
def test_other_folders_are_refused_with_what_is_needed(
    tmp_path: Path, files: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in files:
        (tmp_path / name).write_text("{}")
    assert main(["view", str(tmp_path), "--no-browser"]) == 2
    assert words in capsys.readouterr().err


def test_a_name_of_nothing_lists_sensors_and_tasks() -> None:
    with pytest.raises(InputError, match=r"gelsight_mini.*ball-rolling"):
        find_source("no_such_thing")


def test_files_of_a_folder_are_answered_with_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "press.json"
    path.write_text(json.dumps({}))
    with pytest.raises(InputError, match=f"name the folder .*{tmp_path.name}"):
        find_source(str(path))


def test_without_viser_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", "gelsight_mini", "--no-browser"]) == 2
    assert "pip install 'taccel-lab[view]'" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{", "[]", '{"press": 3}'])
def test_a_press_that_is_none_is_refused_before_a_page_opens(
    tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "press.json").write_text(content)
    assert main(["view", str(tmp_path), "--no-browser", "--port", "0"]) == 2
    assert str(tmp_path) in capsys.readouterr().err
