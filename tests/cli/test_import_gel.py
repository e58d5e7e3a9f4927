# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab import-gel`` lists faces and hands its options to the importer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cad.export import write_step
from taccel_lab.cad.gel_import import FaceSelection
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.cad.parts.pad_solid import labelled_solid
from tests.cli.conftest import Cli


@pytest.fixture
def step(tmp_path: Path) -> Path:
    path = tmp_path / "mine.step"
    write_step(labelled_solid(GelPad()), path)
    return path


def test_without_out_the_faces_are_listed(step: Path, tmp_path: Path, cli: Cli) -> None:
    picture = tmp_path / "faces.png"
    printed = cli("import-gel", step, "--picture", picture).out
    assert picture.read_bytes().startswith(b"\x89PNG")
    # By the name that it had.
    assert cli("import-step", step).out == printed
    assert "middle [mm], outward normal" in printed
    for name in ("contact", "bond", "window", "side"):
        assert f"  {name}\n" in printed
    assert printed.splitlines()[-4:] == [
        "--contact name:contact", "--bond name:bond", "--window name:window", "--normal +z",
    ]  # fmt: skip


def test_options_override_the_selection_file(
    step: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    seen: list[Any] = []

    def stop(path: Path, selection: FaceSelection, *args: object, **_: object) -> None:
        seen.append((path, selection, args))
        raise KeyboardInterrupt

    monkeypatch.setattr("taccel_lab.sensors.imported.import_design", stop)
    file = tmp_path / "faces.toml"
    file.write_text('contact = "normal:+y"\nbond = "plane:-y"\nnormal = "+y"\n')
    arguments = [
        "import-gel", str(step), "--out", str(tmp_path / "out"), "--select", str(file),
        "--bond", "index:0", "index:2", "--window", "rect:18x14", "--edge-mm", "1.5",
    ]  # fmt: skip
    cli(*arguments, code=130)
    ((path, selection, rest),) = seen
    assert path == step and rest == (tmp_path / "out", 1.5)
    assert selection == FaceSelection(
        contact=("normal:+y",), bond=("index:0", "index:2"), window=("rect:18x14",), normal="+y"
    )


def test_bad_input_is_told_without_a_traceback(step: Path, tmp_path: Path, cli: Cli) -> None:
    out, faces = ("import-gel", step, "--out", tmp_path / "out"), tmp_path / "faces.toml"
    stage, told = cli(*out, "--contact", "name:top", code=2).err.split("\n", 1)
    assert stage == "reading and checking the file ..."
    assert told.startswith("error: ") and "names in the file: bond, contact, side, window" in told
    faces.write_text("contact = [1]\nself = 2\n")
    told = cli(*out, "--select", faces, code=2).err
    assert f"{faces}: contact.0: input should be a valid string (found 1)" in told
    assert f"{faces}: self: unknown key; allowed: body, bond" in told
    for words, said in (
        ((*out, "--select", "no.toml"), "no.toml does not exist; expected a TOML file"),
        # Also where nothing would be written yet.
        (("import-gel", tmp_path / "no.step"), "no.step"),
        (("import-gel", step, "--like", "x"), "no sensor 'x'"),
        (("import-gel", step, "--set", "x"), "name=value"),
    ):
        assert said in cli.refusal(*words)
    assert not (tmp_path / "out").exists()
    cli("import-gel", step, "--parts", "assembly", code=2)
