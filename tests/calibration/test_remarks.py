# SPDX-License-Identifier: Apache-2.0
"""The tables of remarks: one code a kind, sentences with figures and error rates, and the docs."""

from __future__ import annotations

import string
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from taccel_lab.benchmarks.results import FOLDER, read_result
from taccel_lab.calibration.check.findings import COMMANDS
from taccel_lab.calibration.error_rates import RATES, quoted
from taccel_lab.calibration.remarks import RemarkKind, remark_kinds, remark_table
from taccel_lab.report.remark import Remark, Severity

KINDS = [kind for _, kind in remark_kinds()]
DOCS = Path(__file__).parents[2] / "docs"


def test_codes_are_unique() -> None:
    counts = Counter(kind.code for kind in KINDS)
    assert [code for code, count in counts.items() if count > 1] == []


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.code)
def test_kinds_are_sound(kind: RemarkKind) -> None:
    assert kind.code == kind.code.lower() and kind.code.isidentifier()
    fields = {name for _, name, _, _ in string.Formatter().parse(kind.text) if name is not None}
    assert all(name.isidentifier() for name in fields)
    assert not fields & {"frames", "blocks", "grave"}
    assert set(kind.blocks) <= set(COMMANDS)
    # Where a figure is a sentence, another one follows behind one stop.
    assert "}{" not in kind.text
    parts = string.Formatter().parse(kind.text)
    values = {name: 1 if spec else "It is so." for _, name, spec, _ in parts if name}
    message = kind(**values).message
    assert "so.." not in message and message == message.strip()


def test_a_remark_takes_figures_images_and_severity() -> None:
    kind = RemarkKind(
        "off", Severity.WARNING, "{count} off by {gap:.1f} px", ("color",), Severity.ERROR
    )
    remark = kind(count=2, gap=1.26, frames=["a", "b"])
    assert str(remark) == "warning: 2 off by 1.3 px"
    assert (remark.code, remark.frames, remark.blocks) == ("off", ("a", "b"), ("color",))
    assert kind(count=2, gap=1.0, grave=True).severity is Severity.ERROR
    assert kind(count=2, gap=1.0, blocks=("depth",)).blocks == ("depth",)


def test_the_docs_list_all_kinds() -> None:
    made = "python -m taccel_lab.calibration.remarks > docs/remarks.md"
    assert (DOCS / "remarks.md").read_text(encoding="utf-8") == remark_table(), made


def test_rates_are_those_of_the_results() -> None:
    """Counts over all sets; of balls that are stated wrongly, sets count."""
    result = read_result(FOLDER / "check_errors.json")
    assert result["complete"]
    rows = result["rows"]
    good = [row for row in rows if row["case"] == "good"]
    for code, rate in RATES.items():
        if code in ("wrong_ball_radius", "ball_too_small"):
            factors = (0.5, 0.7) if code == "wrong_ball_radius" else (0.5,)
            cases = {f"ball stated {factor:g} times as large" for factor in factors}
            tried = [row["by"] for row in rows if row["case"] in cases]
            assert (rate.found, rate.spoiled) == (sum(code in by for by in tried), len(tried))
            continue
        spoiled = [row for row in rows if row.get("code") == code]
        assert rate.good_named == sum(len(row["by_code"][code]) for row in good), code
        assert rate.found == sum(row["named"] for row in spoiled), code
        assert rate.spoiled == sum(row["count"] for row in spoiled), code


def test_good_presses_are_hardly_named() -> None:
    for code, rate in RATES.items():
        assert rate.good >= (100 if rate.of == "presses" else 5), code
        assert rate.good_named <= 0.02 * rate.good, code


def test_a_finding_quotes_its_rates_and_others_stay_as_they_are() -> None:
    finding = Remark(Severity.WARNING, "other_ball", "a ball is wrong", ("p",))
    message = quoted(finding).message
    assert message.startswith("a ball is wrong. On published sets this names ")
    assert f"{RATES['other_ball'].good_named} of {RATES['other_ball'].good} good" in message
    in_brackets = replace(finding, message="a ball (of two) is wrong (look at it)")
    assert quoted(in_brackets).message.startswith(f"{in_brackets.message}. On published")
    other = Remark(Severity.INFO, "one_background", "one")
    assert quoted(other) == other
