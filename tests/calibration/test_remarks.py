# SPDX-License-Identifier: Apache-2.0
"""The tables of remarks: one code a kind, sentences with figures, and the docs."""

from __future__ import annotations

import string
from collections import Counter
from pathlib import Path

import pytest

from taccel_lab import calibration, learning
from taccel_lab.calibration.check.findings import COMMANDS
from taccel_lab.calibration.remarks import RemarkKind, remark_kinds, remark_table
from taccel_lab.report.remark import Severity

KINDS = [kind for _, kind in remark_kinds(calibration, learning)]
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
    made = "python tools/list_remarks.py > docs/remarks.md"
    assert (DOCS / "remarks.md").read_text(encoding="utf-8") == remark_table(
        calibration, learning
    ), made
