# SPDX-License-Identifier: Apache-2.0
"""Suites and their results: schema, atomic rows, options, exit codes."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest
import warp as wp
from tyro._docstrings import get_field_docstring

from taccel_lab.benchmarks.measure import LaunchCounter, MemoryMeter
from taccel_lab.benchmarks.results import (
    Deadline,
    ResultFile,
    benchmark_page,
    read_result,
)
from taccel_lab.benchmarks.speed import Speed
from taccel_lab.cli.bench import COMMANDS, MOVED, options_of, parse_bench
from taccel_lab.errors import InputError
from tests.support.commands import Parser, done, refusal, run
from tools.bench.__main__ import COMMANDS as OF_TOOLS
from tools.bench.__main__ import parse

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def speed_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the suite, through its command line."""
    out = tmp_path_factory.mktemp("speed") / "speed.json"
    arguments = "speed --scene press_239 --envs 1 2 --steps 3 --repeats 2 --no-startup --check"
    assert run("bench", *arguments.split(), "--source", "generated", "--out", out) == 0
    return out


@pytest.mark.thorough
def test_speed_rows(speed_result: Path) -> None:
    document = read_result(speed_result)
    one, two = document["rows"]
    assert document["complete"] is True and (one["envs"], two["envs"]) == (1, 2)
    for row in (one, two):
        assert row["steps"] == 3 and row["fps"]["count"] == 2
        assert row["fps"]["min"] <= row["fps"]["median"] <= row["fps"]["max"]
        assert row["fps"]["median"] <= row["solver_fps"]["median"]
        assert row["residual"]["unconverged"] == row["intersections"] == 0
        assert 0 < row["residual"]["worst_over_allowed"] <= 1
        assert row["residual"]["env_steps"] == 3 * row["envs"]
        # The ball has come down onto the gel.
        assert row["launches_per_step"] > 0 and row["final_forces_n"][0][2] < -0.1
    assert two["memory_mib"] > one["memory_mib"] > 0
    assert document["run"]["packages"]["warp-lang"] == wp.__version__


def test_a_page_counts_the_goals_that_were_met_and_shows_what_differs_first() -> None:
    rows = [
        {"set": f"ball {n}", "place": n, "device": "cpu", "met": n > 2, "error": {"mean": 0.1 * n}}
        for n in range(7)
    ]
    document = {"suite": "s", "what": "w", "run": {}, "settings": {}, "complete": True}
    page = benchmark_page(document | {"rows": rows, "seconds": 1.0}, ("error: mean",))
    assert page.headline == "4 of 7 goals met"
    tables = {table.title: table for table in page.tables}
    assert list(tables["Rows"].columns) == ["set", "met", "error: mean", "place"]
    assert tables["The same in all rows"].rows == [["device", "cpu"]]


def test_a_budget_that_is_spent_starts_nothing_and_finished_rows_survive(tmp_path: Path) -> None:
    assert run("bench", "speed", "--envs", 1, "--budget-s", 0, "--out", tmp_path) == 0
    document = read_result(tmp_path / "speed.json")
    assert document["rows"] == [] and document["complete"] is False
    assert not Deadline(None).passed
    result = ResultFile("speed", "what", tmp_path, "cpu", {})
    with pytest.raises(KeyboardInterrupt), result.finishing():
        result.add({"scene": "peg"}, "peg")
        raise KeyboardInterrupt
    document = read_result(tmp_path / "speed.json")
    assert document["rows"] == [{"scene": "peg"}] and document["complete"] is False


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("speed --scene nonsense", "no scene 'nonsense'"),
        ("speed --envs 0", "at least 1"),
        ("speed --device cup", "device 'cup' is not there; this machine has: cpu"),
        ("speed --set dhat_m", "form name=value"),
        ("learning --observe depth", "--observe must be rgb, wrench or both, got depth"),
        ("learning --observe rgb rgb", "--observe must be rgb, wrench or both, got rgb rgb"),
        ("press_accuracy --tools hammer", "hammer"),
        ("press_accuracy --families no_such", "no_such"),
    ],
)
def test_unusable_input_ends_with_code_two(
    words: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert says in refusal(capsys, "bench", *words.split(), "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(Speed, "measure_rows", lambda *_: pytest.fail("measured"))
    said = refusal(capsys, "bench", "speed", "--out", tmp_path / "file" / "out")
    assert "is a file" in said


def test_options_are_read() -> None:
    words = ["speed", "--envs", "1", "16", "--device", "cuda:0", "--no-startup"]
    assert parse_bench(words) == Speed(envs=(1, 16), device="cuda:0", startup=False)


PROGRAMS = [(["bench"], COMMANDS, None), ([], OF_TOOLS, parse)]
"""First words, places of commands, and the parser where it is not that of ``taccel-lab``."""


@pytest.mark.parametrize(
    ("words", "place", "parsed"),
    [
        ([*first, command], place, parsed)
        for first, commands, parsed in PROGRAMS
        for command, place in commands.items()
    ],
)
def test_every_option_has_help(
    words: list[str], place: str, parsed: Parser | None, capsys: pytest.CaptureFixture[str]
) -> None:
    options = options_of(place)
    for item in dataclasses.fields(options):
        assert get_field_docstring(options, item.name, ()), item.name
        # Results of the repository are written on request only.
        assert item.name != "out" or item.default == Path("out/benchmarks")
    code, out, _ = done(capsys, *words, "--help", parsed=parsed)
    assert code == 0 and (options.__doc__ or "?").split("\n")[0][:40] in out


@pytest.mark.parametrize(("first", "commands", "parsed"), PROGRAMS, ids=["package", "tools"])
def test_commands_are_listed(
    first: list[str],
    commands: dict[str, str],
    parsed: Parser | None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    known = [command.replace("_", "-") for command in commands]
    for words in (first, [*first, "--help"]):
        code, out, _ = done(capsys, *words, parsed=parsed)
        assert code == 0 and all(f"• {command}" in out for command in known)
    code, _, err = done(capsys, *first, "nonsense", parsed=parsed)
    assert code == 2 and f"no command 'nonsense'; known: {', '.join(known)}" in err


def test_what_has_moved_says_where_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(MOVED) == set(OF_TOOLS)
    for command in (*MOVED, "slow-steps"):
        said = f"bench has no {command} any more; run python -m tools.bench {command} in a checkout"
        assert said in refusal(capsys, "bench", command, "--help")
    words = "-m", "tools.bench", "compare", "no_such.json", "no_such.json"
    ended = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 2 and "does not exist" in ended.stderr


# Measuring ------------------------------------------------------------------------------------


@wp.kernel
def _double_kernel(values: wp.array(dtype=wp.float64)):
    i = wp.tid()
    values[i] = wp.float64(2.0) * values[i]


def test_launches_and_memory_are_counted() -> None:
    with MemoryMeter() as meter, LaunchCounter() as launches:
        values = wp.zeros(2**17, dtype=wp.float64)
        for _ in range(3):
            wp.launch(_double_kernel, dim=10, inputs=[values])
        command = wp.launch(_double_kernel, dim=10, inputs=[values], record_cmd=True)
        command.launch()
    assert launches.count == 4
    assert len(launches.kernels) == 1
    wp.launch(_double_kernel, dim=10, inputs=[values])
    assert launches.count == 4
    found = meter.allocations()
    assert found.count == 1
    assert found.peak_bytes == pytest.approx(2**20, rel=0.01)


# Results --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "message"), [("{}", "schema"), ("{", "not valid JSON")])
def test_results_are_checked(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(InputError, match=message):
        read_result(tmp_path / "x.json")
