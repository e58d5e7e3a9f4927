# SPDX-License-Identifier: Apache-2.0
"""Comparison, quick figures and the page of benchmarks: bounds that can fail, pages up to date."""

from __future__ import annotations

import copy
import itertools

import pytest

from taccel_lab.benchmarks.results import REQUIRED, Suite, read_result
from taccel_lab.cli.bench import COMMANDS, options_of
from taccel_lab.errors import InputError
from tools.bench import __main__ as tools_bench
from tools.bench import quick
from tools.bench.compare import IDENTITY, compare, identity
from tools.bench.report.pages import FOLDER, PAGES, read_results, render
from tools.bench.report.sections import HEADLINE, SECTIONS, ratios, read_peers

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


# Results --------------------------------------------------------------------------------------


def test_compare_finds_what_changed_beyond_the_spread() -> None:
    before = read_result(FOLDER / "speed_lag_h200.json")
    after = copy.deepcopy(before)
    row = after["rows"][0]
    assert compare(before, after) == ([], [])
    row["fps"] = {name: 3 * value for name, value in row["fps"].items()}
    row["newton_mean"] *= 1.5
    row["memory_mib"] *= 1.01
    row["unknowns"] *= 1.04  # By some tens, and not by a twentieth.
    after["run"]["driver"] = "580.1"
    remarks, changes = compare(before, after)
    assert remarks == [f"driver: {before['run']['driver']} -> 580.1"]
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


def test_committed_results_follow_the_schema_and_no_two_rows_are_alike() -> None:
    suites = map(options_of, (COMMANDS | tools_bench.COMMANDS).values())
    assert {suite.name for suite in suites if issubclass(suite, Suite)} == set(IDENTITY)
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
        assert render(text, sections, results) == text, "run `python -m tools.bench report`"
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
