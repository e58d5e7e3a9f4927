# SPDX-License-Identifier: Apache-2.0
"""Remarks of calibrations: their kinds, what is put into them, and the list of the docs."""

from __future__ import annotations

import string
from pathlib import Path
from typing import Any

import pytest

from taccel_lab import calibration, learning
from taccel_lab.calibration.blocks import HOMES
from taccel_lab.calibration.remarks import RemarkKind, remark_kinds, remark_table
from taccel_lab.report.remark import Severity

KINDS = [kind for _, kind in remark_kinds(calibration, learning)]


def test_codes_are_unique() -> None:
    codes = sorted(kind.code for kind in KINDS)
    assert codes == sorted(set(codes))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.code)
def test_kinds_are_sound(kind: RemarkKind) -> None:
    assert kind.code == kind.code.lower() and kind.code.isidentifier()
    fields = {name: spec for _, name, spec, _ in string.Formatter().parse(kind.text) if name}
    assert all(name.isidentifier() for name in fields)
    assert not fields.keys() & {"frames", "blocks", "grave"}
    assert set(kind.blocks) <= HOMES.keys()
    # Where a figure is a sentence, another one follows behind one stop.
    assert "}{" not in kind.text
    values: dict[str, Any] = {name: 1 if spec else "It is so." for name, spec in fields.items()}
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
    docs = Path(__file__).parents[2] / "docs" / "remarks.md"
    made = "python tools/list_remarks.py > docs/remarks.md"
    assert docs.read_text(encoding="utf-8") == remark_table(calibration, learning), made
