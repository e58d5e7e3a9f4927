# SPDX-License-Identifier: Apache-2.0
"""Suites, results, comparison and report: schema, atomic rows, exit codes, bounds that can fail."""

from __future__ import annotations

import copy
import dataclasses
import itertools
from pathlib import Path

import pytest
import warp as wp
from tyro._docstrings import get_field_docstring

from taccel_lab.benchmarks import quick
from taccel_lab.benchmarks.compare import IDENTITY, compare, identity
from taccel_lab.benchmarks.measure import LaunchCounter, MemoryMeter
from taccel_lab.benchmarks.report.pages import PAGES, read_results, render
from taccel_lab.benchmarks.report.sections import HEADLINE, SECTIONS, ratios, read_peers
from taccel_lab.benchmarks.results import (
    REQUIRED,
    Deadline,
    ResultFile,
    benchmark_page,
    read_result,
)
from taccel_lab.benchmarks.speed import Speed
from taccel_lab.cli.bench import COMMANDS, options_of, parse_bench
from taccel_lab.errors import InputError
from tests.support.bench import bench


@pytest.fixture(scope="module")
def speed_result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the suite, through its command line."""
    out = tmp_path_factory.mktemp("speed") / "speed.json"
    arguments = "speed --scene press_239 --envs 1 2 --steps 3 --repeats 2 --no-startup --check"
    assert bench([*arguments.split(), "--source", "generated", "--out", str(out)]) == 0
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
    assert bench(["speed", "--envs", "1", "--budget-s", "0", "--out", str(tmp_path)]) == 0
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
        ("compare no_such.json no_such.json", "does not exist"),
        ("learning --observe depth", "--observe must be rgb, wrench or both, got depth"),
        ("learning --observe rgb rgb", "--observe must be rgb, wrench or both, got rgb rgb"),
        ("press_accuracy --tools hammer", "hammer"),
        ("press_accuracy --families no_such", "no_such"),
    ],
)
def test_unusable_input_ends_with_code_two(
    words: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = [] if words.startswith("compare") else ["--out", str(tmp_path)]
    assert bench([*words.split(), *out]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_result_that_cannot_be_written_is_refused_before_anything_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(Speed, "measure_rows", lambda *_: pytest.fail("measured"))
    assert bench(["speed", "--out", str(tmp_path / "file" / "out")]) == 2
    assert "is a file" in capsys.readouterr().err


def test_options_are_read() -> None:
    words = ["speed", "--envs", "1", "16", "--device", "cuda:0", "--no-startup"]
    assert parse_bench(words) == Speed(envs=(1, 16), device="cuda:0", startup=False)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = options_of(command)
    for item in dataclasses.fields(options):
        assert get_field_docstring(options, item.name, ()), item.name
        # Results of the repository are written on request only.
        assert item.name != "out" or item.default == Path("out/benchmarks")
    with pytest.raises(SystemExit) as done:
        bench([command, "--help"])
    assert done.value.code == 0
    assert (options.__doc__ or "?").split("\n")[0][:40] in capsys.readouterr().out


def test_commands_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--help"]):
        with pytest.raises(SystemExit) as done:
            bench(words)
        assert done.value.code == 0
        text = capsys.readouterr().out
        assert all(f"• {command.replace('_', '-')}" in text for command in COMMANDS)
    assert bench(["nonsense"]) == 2
    assert "no command 'nonsense'; known: speed, learning" in capsys.readouterr().err


# Quick figures --------------------------------------------------------------------------------


@pytest.mark.thorough
def test_quick_figures_are_those_of_the_baseline() -> None:
    findings = list(quick.out_of_bounds(quick.read_baseline(), quick.measure_all()))
    assert [f.describe() for f in findings if f.is_failure] == []


@pytest.mark.parametrize("figure", [*quick.RISE, "forces_n", "unconverged", "intersections"])
def test_quick_notices(figure: str) -> None:
    baseline = quick.read_baseline()
    worse = copy.deepcopy(baseline)
    changed = next(iter(worse.values()))
    if figure == "forces_n":
        changed["forces_n"][0][0] *= 1.01
    else:
        changed[figure] = 1.2 * changed[figure] if figure in quick.RISE else 1
    assert list(quick.out_of_bounds(baseline, baseline)) == []
    (finding,) = quick.out_of_bounds(baseline, worse)
    assert (finding.figure, finding.is_failure) == (figure, True)


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


def test_compare_finds_what_changed_beyond_the_spread(speed_result: Path) -> None:
    before = read_result(speed_result)
    after = copy.deepcopy(before)
    row = after["rows"][0]
    assert compare(before, after) == ([], [])
    row["fps"] = {name: 3 * value for name, value in row["fps"].items()}
    row["newton_mean"] *= 1.5
    row["memory_mib"] *= 1.01
    row["unknowns"] *= 1.04  # By some tens, and not by a twentieth.
    after["run"]["driver"] = "580.1"
    remarks, changes = compare(before, after)
    assert remarks == ["driver: None -> 580.1"]
    assert {change.figure for change in changes} == {"fps", "newton_mean"}
    assert changes[0].percent == pytest.approx(200)
    row["fps"] |= {"max": []}
    with pytest.raises(InputError, match="fps has a spread that is not all numbers"):
        compare(before, after)
    row["fps"] = before["rows"][0]["fps"]
    with pytest.raises(InputError, match="suites differ"):
        compare(before, after | {"suite": "error"})
    with pytest.raises(InputError, match="results of 'error' are not compared"):
        compare(before | {"suite": "error"}, after | {"suite": "error"})


@pytest.mark.parametrize(("text", "message"), [("{}", "schema"), ("{", "not valid JSON")])
def test_results_are_checked(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(InputError, match=message):
        read_result(tmp_path / "x.json")


def test_committed_results_follow_the_schema_and_no_two_rows_are_alike() -> None:
    suites = map(options_of, COMMANDS)
    assert {suite.name for suite in suites if hasattr(suite, "name")} == set(IDENTITY)
    for document in itertools.chain(*read_results().values()):
        rows = document["rows"]
        assert rows and set(REQUIRED) <= set(document)
        if document["suite"] in IDENTITY:
            assert len({identity(document["suite"], row) for row in rows}) == len(rows)


def test_meshes_of_ours_are_compared_with_nobody() -> None:
    """Ours of the peg have a third fewer unknowns than the published ones."""
    results = read_results()
    changed = copy.deepcopy(results)
    for document in itertools.chain(changed["speed"], changed["learning"]):
        for row in [row for row in document["rows"] if row["scene"] == "peg"]:
            faster = copy.deepcopy(row) | {"source": "generated"}
            faster["fps"]["median"] *= 10
            document["rows"].append(faster)
    assert HEADLINE["headline"](changed) == HEADLINE["headline"](results)
    assert SECTIONS["peers"](changed) == SECTIONS["peers"](results)
    assert "peg, generated meshes" in SECTIONS["speed"](changed)


def test_the_pages_are_up_to_date() -> None:
    results = read_results()
    for page, sections in PAGES.items():
        text = page.read_text(encoding="utf-8")
        assert render(text, sections, results) == text, "run `taccel-lab bench report`"
        for line in text.splitlines():
            if line.startswith("!["):
                assert (page.parent / line.split("(")[1].rstrip(")")).is_file(), line
    assert all(section({}) for section in (*SECTIONS.values(), *HEADLINE.values()))
    with pytest.raises(InputError, match="begin speed"):
        render("# Page", SECTIONS, {})
    for entry in read_peers()["peg"]:
        assert entry["stop"] and entry["device"] and entry["kind"] in ("measured", "published")
        assert all(value > 0 for value in entry["fps"].values())


def test_ratios_are_of_equal_devices_and_counts() -> None:
    own = {"name": "**taccel-lab**", "device": "H200", "stop": "", "fps": {"1": 300.0, "16": 50.0}}
    other = {"name": "peer", "device": "H200", "stop": "loose", "fps": {"1": 100.0, "64": 9.0}}
    text = ratios([own], [other, other | {"device": "H100"}])
    assert text.count("peer") == 1
    assert "3 times at 1" in text and "64" not in text
    assert ratios([own], []) == ""
