# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab export`` from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.exporters.formats import FORMATS
from taccel_lab.profile import save_profile
from tests.cli.conftest import Cli
from tests.support.synthetic_presses import GRID, tiny_profile


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    save_profile(tiny_profile(GRID), tmp_path / "profile")
    return tmp_path / "profile"


def test_help_lists_every_format_with_a_sentence(cli: Cli) -> None:
    shown = " ".join(cli("export --help").out.replace("│", " ").split())
    for name, sentence in FORMATS.items():
        assert f"{name}: {sentence}" in shown


def test_an_export_says_what_it_wrote_and_left_out(profile: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    text = cli("export", profile, "--to", "urdf", "--out", out).out
    assert "left out" in text and "housing" in text
    assert (out / "sensor.urdf").is_file()
    files = cli.json("export", profile, "--to", "urdf", "--out", out)["files"]
    assert files == ["meshes/gel.stl", "sensor.urdf"]


def test_refusals(profile: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    told = cli.refusal("export", profile, "--to", "taxim", "--out", out)
    assert "block color" in told and "taccel-lab calibrate color" in told
    # The profile's own folder was not written by an export.
    assert "did not write" in cli.refusal("export", profile, "--to", "urdf", "--out", profile)
    assert (profile / "profile.toml").is_file()
    told = cli.refusal("export", tmp_path / "nowhere", "--to", "urdf", "--out", out)
    assert "no such profile folder" in told and not out.exists()
