# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab study`` and ``dataset``; ``test_refusals.py`` has what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from taccel_lab.api.study import plan_study
from taccel_lab.cli.dataset import with_make
from taccel_lab.studies.evaluate.runner import default_kit
from tests.cli.conftest import DATASET, Cli, use
from tests.support.fake_kit import evaluate, logged
from tests.support.short_files import files_at_most


def stopped(designs, presses, metrics, **rest):
    """Ctrl-C at the second design."""
    if designs[0].parameters["thickness_mm"] == 5.0:
        raise KeyboardInterrupt
    return evaluate(designs, presses, metrics, **rest)


@pytest.mark.thorough
def test_a_study_runs_and_says_where_to_look(study: Path, cli: Cli) -> None:
    _, out, err = cli("study", study)
    assert "3 designs compared" in out and "stiffness" in out
    lines = [line for line in err.splitlines() if " designs: thickness " in line]
    assert len(lines) == 3 and lines[0].startswith("1 of 3 designs: thickness 4 mm: stiffness 0.")
    assert all(f"thickness {mm} mm" in out for mm in (4, 5, 6))
    assert "out/thickness/designs.csv" in err and "out/thickness/report.html" in err
    root = study.parent / "out" / "thickness"
    assert (root / "study.toml").read_text() == study.read_text(encoding="utf-8")
    assert len((root / "designs.csv").read_text().splitlines()) == 4
    assert "3 of 3 designs are there already" in cli("study", study).err
    assert len(logged(root)) == 3


@pytest.mark.slow
def test_processes_of_the_study_file_count(study: Path, cli: Cli) -> None:
    study.write_text(f"{study.read_text()}[run]\nprocesses = 2\n", encoding="utf-8")
    cli("study", study, "--out", "two", "--json")
    values = json.loads((study.parent / "two" / "report.json").read_text())
    assert values["cost"]["processes"] == 2


@pytest.mark.thorough
def test_limit_and_report_only(study: Path, cli: Cli) -> None:
    err = cli("study", study, "--out", "a b", "--limit", "2").err
    assert "not finished; go on with" in err and f"taccel-lab study {study} --out 'a b'" in err
    assert cli.json("study", study, "--out", "a b", "--report-only")["counts"]["rows"] == 2
    assert len(logged(study.parent / "a b")) == 2


def test_a_report_alone_names_no_table_that_is_not_there(study: Path, cli: Cli) -> None:
    """A study of which no design has finished, and one of which there is no folder."""
    root = study.parent / "out"
    assert "holds no study; run it first" in cli("study", study, "--report-only", code=2).err
    root.mkdir()
    (root / ".taccel_lab_study").touch()
    printed = cli("study", study, "--out", "out", "--report-only")
    assert "no table: none of the designs has been evaluated" in printed.err
    assert "designs.csv" not in printed.err + printed.out
    assert (root / "report.html").is_file() and "report: out/report.html" in printed.err


@pytest.mark.parametrize(
    ("changes", "given", "there"),
    [
        ([], ["thickness_mm=3,4.5"], [3, 4.5]),
        ([], ["thickness_mm=4"], [4]),
        ([("[parameters.thickness_mm]\nvalues =", "[parameters]\nthickness_mm =")], [], [4, 5, 6]),
        # What the file fixes or ties is swept just as well.
        ([("[sweep]", "[fixed]\nfriction = 0.5\n[sweep]")], ["friction=0.2,0.4"], [4, 5, 6]),
    ],
)
def test_values_may_be_set_and_lists_be_plain(
    changes: list[tuple[str, str]], given: list[str], there: list[float], study: Path, cli: Cli
) -> None:
    text = study.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    study.write_text(text, encoding="utf-8")
    told = cli("study", study, "--out", "out", "--limit", "1", *(["--set", *given] * bool(given)))
    more = " --set ".join(["", *given])
    if len(there) > 1 or "friction" in str(given):
        assert f"taccel-lab study {study} --out out{more}" in told.err
    plan = plan_study(study.parent / "out" / "study.toml")
    axes = {axis.name: list(axis.values or ()) for axis in plan.axes}
    assert axes["thickness_mm"] == there
    assert axes.get("friction", [0.2, 0.4]) == [0.2, 0.4]


def test_what_is_set_wrongly_is_refused(study: Path, cli: Cli) -> None:
    for words, said in (
        (("--set", "thicknes_mm=3"), "thickness_mm"),
        (("--set", "thickness_mm=3,3"), "repeat"),
        (("--set", "thickness_mm=-3,4"), "thickness_mm"),
        (("--set", "thickness_mm"), "name=value"),
        (("--set", "thickness_mm=3", "--submit", "local"), "--set"),
    ):
        assert said in cli.refusal("study", study, "--out", "out", *words)
    assert not (study.parent / "out").exists()


def test_the_terminal_ranks_all_designs_by_the_metric_that_is_named(study: Path, cli: Cli) -> None:
    text = study.read_text(encoding="utf-8")
    study.write_text(f'{text}[objective]\nminimize = "stiffness"\n', encoding="utf-8")
    cli("study", study, "--out", "out", "--set", "thickness_mm=3,4,5,6,7")
    printed = cli("study", study, "--out", "out", "--set", "thickness_mm=3,4,5,6,7").out
    table = printed[printed.index("all designs: least stiffness") :]
    shown = [float(line.split()[1]) for line in table.splitlines() if " mm " in line]
    assert shown == [7, 6, 5, 4, 3]


@pytest.mark.parametrize("width", [30, 60, 120])
def test_no_name_of_the_table_is_broken(
    width: int, study: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    """Metrics are left out where a terminal is narrow, to a single one."""
    long = '"stiffness", "range", "blur", "lamps"'
    study.write_text(study.read_text().replace('"stiffness", "range"', long))
    monkeypatch.setenv("COLUMNS", str(width))
    printed = cli("study", study, "--out", "out").out
    words = printed[printed.index("all designs") :].split()
    assert "stiffness" in words and ("lamps" in words) == (width == 120)


@pytest.mark.thorough
def test_interruption_says_how_to_go_on(
    study: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    use(monkeypatch, stopped)
    told = cli("study", study, "--out", "out", code=130).err
    kept = f"1 finished design stays in out; go on with: taccel-lab study {study} --out out"
    assert f"interrupted; {kept}\n" in told
    assert len((study.parent / "out" / "designs.csv").read_text().splitlines()) == 2
    use(monkeypatch)
    cli("study", study, "--out", "out")
    assert len(logged(study.parent / "out")) == 3


@pytest.mark.thorough
def test_no_design_is_to_blame_for_a_full_disk(study: Path, cli: Cli) -> None:
    """A design whose files found no room is made again; it was kept without them."""
    study.write_text(study.read_text().replace("meshes = false", "meshes = true"))
    with files_at_most(20_000):
        said = cli("study", study, "--out", "out", code=2).err.splitlines()[-1]
    assert said.startswith("error: ")
    assert ".vtu: File too large; no design has finished; go on with" in said
    assert said.endswith(f"go on with: taccel-lab study {study} --out out")
    assert not list((study.parent / "out").rglob(".*.vtu"))
    cli("study", study, "--out", "out")
    rows = [json.loads(path.read_text()) for path in study.parent.glob("out/designs/*/result.json")]
    assert len(rows) == 3
    assert all((study.parent / "out" / row["files"]["mesh"]).is_file() for row in rows)


@pytest.mark.thorough
def test_no_design_within_the_constraints_is_exit_code_1(study: Path, cli: Cli) -> None:
    study.write_text(study.read_text() + '[[constraints]]\nmetric = "range"\nmin = 1000\n')
    told = cli("study", study, "--out", "out", code=1).out
    assert "range at least 1000 is missed by" in " ".join(told.split())
    page = (study.parent / "out" / "report.html").read_text(encoding="utf-8")
    assert "No design keeps the constraints" in page


def test_no_figures_at_all_is_exit_code_3(study: Path, cli: Cli) -> None:
    study.write_text(study.read_text() + '\n[fixed]\nrim = "fillet"\n')
    assert "no design has a figure" in cli("study", study, "--out", "out", code=3).err


def test_lists_and_help(cli: Cli) -> None:
    kit, lists = default_kit(), "study --list-metrics --list-presses"
    listed = cli.json(lists)
    assert list(listed["metrics"]) == list(kit.metrics)
    assert list(listed["presses"]) == list(kit.presses)
    out = cli(lists).out
    assert all(name in out for name in (*kit.metrics, *kit.presses))
    text = cli("study --help").out
    assert "taccel-lab study mini_thickness_hardness" in text
    assert "docs/studies.md" in text and "--report-only" in text


def test_make_may_be_left_out() -> None:
    assert with_make(["dataset", "a.toml", "--out", "b"])[:3] == ["dataset", "make", "a.toml"]
    for words in (["dataset", "check", "b"], ["dataset", "--help"], ["dataset"], ["study", "a"]):
        assert with_make(words) == words


@pytest.mark.thorough
def test_made_checked_shown_and_gone_on_with(tmp_path: Path, cli: Cli) -> None:
    out, spec = tmp_path / "out", tmp_path / "one.toml"
    spec.write_text(DATASET)
    cli("dataset", spec, "--out", out, "--check-only")
    command = ["dataset", spec, "--out", out, "--processes", "0"]
    cli(*command, "--no-write")
    assert not out.exists()
    said = cli(*command, "--json")
    assert "2 images of 1 touches" in said.err
    assert json.loads(said.out)["images_per_s"] > 0
    assert "0 images of 0 touches" in cli(*command).err
    assert "0 errors" in cli("dataset check", out).err
    assert "has no rgb" in cli.refusal("dataset export univtac", out, "--out", tmp_path / "u")
    next((out / "parts").rglob("steps.parquet")).write_bytes(b"half")
    assert "is not what was written" in cli("dataset check", out, code=1).err
