# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab study``: exit codes, what is printed, what is left behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.studies.study import Kit, default_kit
from tests.support.fake_kit import METRICS, PRESSES, evaluate, logged

STUDY = """
[study]
name = "Thickness"
sensor = "gelsight"
metrics = ["stiffness", "range"]

[parameters.thickness_mm]
values = [4.0, 5.0, 6.0]

[sweep]
kind = "grid"

[output]
meshes = false
pictures = false

[run]
processes = 2
"""
CONSTRAINT = '\n[[constraints]]\nmetric = "range"\nmin = 1000\n'


def stopped(designs, presses, metrics, **rest):
    """Ctrl-C at the second design."""
    if designs[0].parameters["thickness_mm"] == 5.0:
        raise KeyboardInterrupt
    return evaluate(designs, presses, metrics, **rest)


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study file in a folder of its own; fakes press, in this process."""
    use(monkeypatch, evaluate)
    monkeypatch.setattr("taccel_lab.studies.runner.default_processes", lambda device: 0)
    path = tmp_path / "thickness.toml"
    path.write_text(STUDY.replace("\n[run]\nprocesses = 2\n", ""))
    monkeypatch.chdir(tmp_path)
    return path


def use(monkeypatch: pytest.MonkeyPatch, how) -> None:
    monkeypatch.setattr("taccel_lab.studies.study.default_kit", lambda: Kit(PRESSES, METRICS, how))


def test_a_study_runs_and_says_where_to_look(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert app.main(["study", str(file)]) == 0
    out, err = capsys.readouterr()
    assert "3 designs compared" in out and "stiffness" in out
    assert "3 of 3 designs, 0 failed" in err
    assert "out/thickness/designs.csv" in err and "out/thickness/report.html" in err
    root = file.parent / "out" / "thickness"
    assert (root / "study.toml").read_text() == file.read_text(encoding="utf-8")
    assert len((root / "designs.csv").read_text().splitlines()) == 4
    assert app.main(["study", str(file)]) == 0
    assert "3 of 3 designs are there already" in capsys.readouterr().err
    assert len(logged(root)) == 3


def test_processes_of_the_study_file_count(file: Path) -> None:
    file.write_text(STUDY, encoding="utf-8")
    assert app.main(["study", str(file), "--out", "two", "--json"]) == 0
    values = json.loads((file.parent / "two" / "report.json").read_text())
    assert values["cost"]["processes"] == 2


def test_limit_and_report_only(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["study", str(file), "--out", "a b", "--limit", "2"]) == 0
    err = capsys.readouterr().err
    assert "not finished; go on with" in err and f"taccel-lab study {file} --out 'a b'" in err
    assert app.main(["study", str(file), "--out", "a b", "--report-only", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["counts"]["rows"] == 2
    assert len(logged(file.parent / "a b")) == 2


def test_interruption_says_how_to_go_on(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    use(monkeypatch, stopped)
    with pytest.raises(SystemExit) as caught:
        app.main(["study", str(file), "--out", "out"])
    assert caught.value.code == 130
    assert f"Go on with:\n  taccel-lab study {file} --out out" in capsys.readouterr().err
    assert len((file.parent / "out" / "designs.csv").read_text().splitlines()) == 2
    use(monkeypatch, evaluate)
    assert app.main(["study", str(file), "--out", "out"]) == 0
    assert len(logged(file.parent / "out")) == 3


def test_no_design_within_the_constraints_is_exit_code_1(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(file.read_text(encoding="utf-8") + CONSTRAINT, encoding="utf-8")
    with pytest.raises(SystemExit) as caught:
        app.main(["study", str(file), "--out", "out"])
    assert caught.value.code == 1
    assert "range at least 1000 is missed by" in " ".join(capsys.readouterr().out.split())
    page = (file.parent / "out" / "report.html").read_text(encoding="utf-8")
    assert "No design keeps the constraints" in page


def test_no_figures_at_all_is_exit_code_3(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text(
        file.read_text(encoding="utf-8") + '\n[fixed]\nrim = "fillet"\n', encoding="utf-8"
    )
    assert app.main(["study", str(file), "--out", "out"]) == 3
    assert "no design has a figure" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study"], "name a study file"),
        (["study", "none.toml"], "none.toml does not exist"),
        (["study", "thickness.toml", "--limit", "0"], "limit must be at least 1"),
        (["study", "thickness.toml", "--processes", "0"], "processes must lie in 1..1024"),
        (["study", "thickness.toml", "--device", "cuda:99"], "device 'cuda:99' is not there"),
        (["study", "thickness.toml", "--out", "."], "holds files and no study"),
        (["study", "thickness.toml", "--out", "thickness.toml"], "is a file"),
        (["study", "thickness.toml", "--out", "new", "--report-only"], "holds no study"),
    ],
)
def test_bad_calls_leave_nothing_behind(
    file: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    before = sorted(file.parent.rglob("*"))
    assert app.main(arguments) == 2
    assert message in capsys.readouterr().err
    assert sorted(file.parent.rglob("*")) == before


def test_bad_files_name_the_key(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text(file.read_text(encoding="utf-8").replace('"range"', '"rang"'), encoding="utf-8")
    assert app.main(["study", str(file)]) == 2
    assert "no metric 'rang' (did you mean range?)" in capsys.readouterr().err


def test_lists(capsys: pytest.CaptureFixture[str]) -> None:
    kit = default_kit()
    assert app.main(["study", "--list-metrics", "--list-presses", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert list(listed["metrics"]) == list(kit.metrics)
    assert list(listed["presses"]) == list(kit.presses)
    assert app.main(["study", "--list-metrics", "--list-presses"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in (*kit.metrics, *kit.presses))


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        app.main(["study", "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert "taccel-lab study studies/examples/mini_thickness_hardness.toml" in text
    assert "docs/studies.md" in text and "--report-only" in text
