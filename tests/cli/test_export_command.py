# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab export`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.profile import save_profile
from tests.support.synthetic_presses import GRID, tiny_profile


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    save_profile(tiny_profile(GRID), tmp_path / "profile")
    return tmp_path / "profile"


def test_help_lists_every_format_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    from taccel_lab.interop.formats import FORMATS

    with pytest.raises(SystemExit) as caught:
        app.main(["export", "--help"])
    assert caught.value.code == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name, sentence in FORMATS.items():
        assert f"{name}: {sentence}" in shown


def test_an_export_says_what_it_wrote_and_left_out(
    profile: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert app.main(["export", str(profile), "--to", "urdf", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "left out" in text and "housing" in text
    assert (out / "sensor.urdf").is_file()
    assert app.main(["export", str(profile), "--to", "urdf", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == ["meshes/gel.stl", "sensor.urdf"]


def test_a_missing_block_is_exit_code_2(
    profile: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert app.main(["export", str(profile), "--to", "taxim", "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "block color" in message and "taccel-lab calibrate color" in message
    assert "Traceback" not in message and not out.exists()


def test_foreign_files_and_missing_profiles_are_refused(
    profile: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The profile's own folder was not written by an export.
    assert app.main(["export", str(profile), "--to", "urdf", "--out", str(profile)]) == 2
    assert "did not write" in capsys.readouterr().err
    assert (profile / "profile.toml").is_file()
    nowhere = str(tmp_path / "nowhere")
    assert app.main(["export", nowhere, "--to", "urdf", "--out", str(tmp_path / "out")]) == 2
    assert "no such profile folder" in capsys.readouterr().err
