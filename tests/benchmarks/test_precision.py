# SPDX-License-Identifier: Apache-2.0
"""A copy of the package in single precision, and what the suite says of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import taccel_lab
from taccel_lab.benchmarks.precision import (
    Precision,
    write_double_precision,
    write_single_precision,
)
from taccel_lab.errors import InputError


def test_nothing_of_the_copy_is_double(tmp_path: Path) -> None:
    copy = write_single_precision(tmp_path)
    texts = {path: path.read_text(encoding="utf-8") for path in copy.rglob("*.py")}
    assert len(texts) > 500
    for path, text in texts.items():
        if path.name != "precision.py":
            compile(text, str(path), "exec")
            assert "wp.float64" not in text and "wp.vec3d" not in text
    assert "wp.vec3f" in texts[copy / "ipc" / "friction.py"]
    with pytest.raises(InputError, match="exists already"):
        write_single_precision(tmp_path)


def test_a_copy_multiplies_what_is_not_rounded(tmp_path: Path) -> None:
    copy = write_double_precision(tmp_path)
    changed = {
        path.name
        for path in copy.rglob("*.py")
        if path.read_bytes()
        != (Path(taccel_lab.__file__).parent / path.relative_to(copy)).read_bytes()
    }
    assert changed == {"block_cg.py", "pipelined_cg.py"}
    assert "clusters.tasks.shape[0] / 3" not in (copy / "ipc/linear/pipelined_cg.py").read_text()


@pytest.mark.slow
def test_single_precision_stops_short_of_what_double_reaches(tmp_path: Path) -> None:
    out = tmp_path / "found.json"
    Precision(scene=("press_239",), steps=6, tolerances=(1e-2, 1e-4), out=out).run()
    rows = json.loads(out.read_text(encoding="utf-8"))["rows"]
    failed = {(r["precision"], r["tolerance"]): r["residual"]["unconverged"] for r in rows}
    assert failed["double", 1e-2] == failed["double", 1e-4] == 0
    assert failed["single", 1e-4] > failed["single", 1e-2]
