# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate all``: stages in order, what is skipped and refused, one profile."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.profile import load_profile
from tests.cli.small_captures import write_captures


@pytest.fixture
def captures(tmp_path: Path) -> Path:
    return write_captures(tmp_path / "captures")


def run(*arguments: str) -> int:
    try:
        return app.main(["calibrate", "all", *arguments])
    except SystemExit as stop:
        return int(stop.code or 0)


def test_stages_build_on_one_another(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "unit"
    stages = ["--only", "background", "markers", "spread"]
    assert run(str(captures), "--out", str(out), *stages, "--json") == 0
    shown = json.loads(capsys.readouterr().out)["stages"]
    assert [(s["name"], s["state"]) for s in shown] == [
        ("background", "done"),
        ("markers", "skipped"),
        ("spread", "done"),
    ]
    assert "dots at rest" in shown[1]["message"]
    profile = load_profile(out)
    assert profile.background is not None and profile.perturbation is not None
    assert profile.background.provenance.kind == "calibrated"
    report = tmp_path / "unit_report"
    assert (report / "background" / "report.html").is_file()
    html = (report / "report.html").read_text(encoding="utf-8")
    assert "Stages" in html and "perturbation" in html
    assert not list(tmp_path.glob(".*"))


def test_a_refusing_stage_is_told_and_the_others_go_on(
    captures: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from taccel_lab.cli.calibrate.background import CalibrateBackground
    from taccel_lab.errors import InputError

    def refuse(self: CalibrateBackground) -> None:
        raise InputError("the light is off")

    monkeypatch.setattr(CalibrateBackground, "run", refuse)
    out = tmp_path / "unit"
    stages = ["--only", "background", "spread"]
    assert run(str(captures), "--out", str(out), *stages) == 1
    assert "the light is off" in "".join(capsys.readouterr())
    assert load_profile(out).perturbation is not None
    data = json.loads((tmp_path / "unit_report" / "report.json").read_text(encoding="utf-8"))
    assert data["verdict"] == "weak" and data["stages"][0]["state"] == "refused"


def test_nothing_to_do_writes_nothing(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(captures), "--out", str(tmp_path / "unit"), "--only", "markers") == 2
    assert "nothing could be calibrated" in capsys.readouterr().err
    assert not (tmp_path / "unit").exists() and not (tmp_path / "unit_report").exists()


def test_an_unknown_stage_is_refused(
    captures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(captures), "--out", str(tmp_path / "unit"), "--only", "colour") == 2
    assert "no stage colour; there are camera, scale" in capsys.readouterr().err
