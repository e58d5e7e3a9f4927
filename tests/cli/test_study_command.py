# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab study`` and ``dataset``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.cli.dataset import with_make
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.spec.study import Kit
from tests.cli.conftest import Cli
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
    monkeypatch.setattr("taccel_lab.studies.evaluate.runner.default_processes", lambda device: 0)
    path = tmp_path / "thickness.toml"
    path.write_text(STUDY.replace("\n[run]\nprocesses = 2\n", ""))
    monkeypatch.chdir(tmp_path)
    return path


def use(monkeypatch: pytest.MonkeyPatch, how) -> None:
    monkeypatch.setattr("taccel_lab.api.study.default_kit", lambda: Kit(PRESSES, METRICS, how))


@pytest.mark.thorough
def test_a_study_runs_and_says_where_to_look(file: Path, cli: Cli) -> None:
    _, out, err = cli("study", file)
    assert "3 designs compared" in out and "stiffness" in out
    assert "3 of 3 designs, 0 failed" in err
    assert "out/thickness/designs.csv" in err and "out/thickness/report.html" in err
    root = file.parent / "out" / "thickness"
    assert (root / "study.toml").read_text() == file.read_text(encoding="utf-8")
    assert len((root / "designs.csv").read_text().splitlines()) == 4
    assert "3 of 3 designs are there already" in cli("study", file).err
    assert len(logged(root)) == 3


@pytest.mark.slow
def test_processes_of_the_study_file_count(file: Path, cli: Cli) -> None:
    file.write_text(STUDY, encoding="utf-8")
    cli("study", file, "--out", "two", "--json")
    values = json.loads((file.parent / "two" / "report.json").read_text())
    assert values["cost"]["processes"] == 2


@pytest.mark.thorough
def test_limit_and_report_only(file: Path, cli: Cli) -> None:
    err = cli("study", file, "--out", "a b", "--limit", "2").err
    assert "not finished; go on with" in err and f"taccel-lab study {file} --out 'a b'" in err
    assert cli.json("study", file, "--out", "a b", "--report-only")["counts"]["rows"] == 2
    assert len(logged(file.parent / "a b")) == 2


@pytest.mark.thorough
def test_interruption_says_how_to_go_on(
    file: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    use(monkeypatch, stopped)
    told = cli("study", file, "--out", "out", code=130).err
    kept = f"what is finished stays in out; go on with: taccel-lab study {file} --out out"
    assert f"interrupted; {kept}\n" in told
    assert len((file.parent / "out" / "designs.csv").read_text().splitlines()) == 2
    use(monkeypatch, evaluate)
    cli("study", file, "--out", "out")
    assert len(logged(file.parent / "out")) == 3


@pytest.mark.thorough
def test_no_design_within_the_constraints_is_exit_code_1(file: Path, cli: Cli) -> None:
    file.write_text(file.read_text(encoding="utf-8") + CONSTRAINT, encoding="utf-8")
    told = cli("study", file, "--out", "out", code=1).out
    assert "range at least 1000 is missed by" in " ".join(told.split())
    page = (file.parent / "out" / "report.html").read_text(encoding="utf-8")
    assert "No design keeps the constraints" in page


def test_no_figures_at_all_is_exit_code_3(file: Path, cli: Cli) -> None:
    file.write_text(file.read_text() + '\n[fixed]\nrim = "fillet"\n')
    assert "no design has a figure" in cli("study", file, "--out", "out", code=3).err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("study", "name a study file"),
        ("study none.toml", "none.toml does not exist"),
        ("study none", "no example has that name; known: design_track, digit_curvature,"),
        ("study thickness.toml --limit 0", "limit must be at least 1"),
        ("study thickness.toml --processes 0", "processes must lie in 1..1024"),
        ("study thickness.toml --out .", "holds files and no study"),
        ("study thickness.toml --out thickness.toml", "is a file"),
        ("study thickness.toml --out new --report-only", "holds no study"),
        ("study rang.toml", "no metric 'rang' (did you mean range?)"),
    ],
)
def test_bad_calls_leave_nothing_behind(file: Path, cli: Cli, arguments: str, message: str) -> None:
    file.with_name("rang.toml").write_text(file.read_text().replace('"range"', '"rang"'))
    before = sorted(file.parent.rglob("*"))
    assert message in cli.refusal(arguments)
    assert sorted(file.parent.rglob("*")) == before


def test_lists(cli: Cli) -> None:
    kit = default_kit()
    listed = cli.json("study", "--list-metrics", "--list-presses")
    assert list(listed["metrics"]) == list(kit.metrics)
    assert list(listed["presses"]) == list(kit.presses)
    out = cli("study", "--list-metrics", "--list-presses").out
    assert all(name in out for name in (*kit.metrics, *kit.presses))


def test_help_teaches(cli: Cli) -> None:
    text = cli("study --help").out
    assert "taccel-lab study mini_thickness_hardness" in text
    assert "docs/studies.md" in text and "--report-only" in text


SPEC = """
[dataset]
name = "one"
episodes = 1
view = 0.2
accuracy = "fast"
[[sensors]]
profile = "flat_pad"
[[objects]]
tool = "sphere:2"
[[motions]]
kind = "press"
depth_mm = [0.1, 0.1]
[output]
channels = ["depth_mm", "patch_forces_n"]
size_px = [32, 24]
"""


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "one.toml"
    path.write_text(SPEC)
    return path


def test_make_may_be_left_out() -> None:
    assert with_make(["dataset", "a.toml", "--out", "b"])[:3] == ["dataset", "make", "a.toml"]
    for words in (["dataset", "check", "b"], ["dataset", "--help"], ["dataset"], ["study", "a"]):
        assert with_make(words) == words


@pytest.mark.thorough
def test_made_checked_shown_and_gone_on_with(spec: Path, tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    cli("dataset", spec, "--out", out, "--check-only")
    command = ["dataset", spec, "--out", out, "--processes", "0"]
    cli(*command, "--no-write")
    assert not out.exists()
    said = cli(*command, "--json")
    assert "2 images of 1 touches" in said.err
    assert json.loads(said.out)["images_per_s"] > 0
    assert "0 images of 0 touches" in cli(*command).err
    assert "0 errors" in cli("dataset check", out).err
    assert "has no rgb" in cli.refusal("dataset export", "univtac", out, "--out", tmp_path / "u")
    next((out / "parts").rglob("steps.parquet")).write_bytes(b"half")
    assert "is not what was written" in cli("dataset check", out, code=1).err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--shard", "3/2"], "shard '3/2' is not understood"),
        (["--check-only"], "output.sizes_px: unknown key; allowed: channels, size_px"),
    ],
)
def test_bad_words(spec: Path, tmp_path: Path, words: list[str], message: str, cli: Cli) -> None:
    if "unknown key" in message:
        spec.write_text(SPEC + "sizes_px = [3, 4]\n")
    assert message in cli.refusal("dataset", spec, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()
