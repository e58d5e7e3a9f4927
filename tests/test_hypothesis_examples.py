# SPDX-License-Identifier: Apache-2.0
"""Property-based tests try the same examples in every run and in every order."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st


def drawn() -> list[int]:
    examples: list[int] = []

    @seed(1)
    @settings(max_examples=300, derandomize=False, database=None)
    @given(st.integers(0, 10**9))
    def look(number: int) -> None:
        examples.append(number)

    look()
    return examples


def test_examples_do_not_depend_on_the_modules_that_are_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = drawn()
    assert len(set(before)) > 100
    path = tmp_path / "with_constants.py"
    path.write_text("".join(f"C{n} = {n}\n" for n in range(700_001, 700_100)))
    spec = importlib.util.spec_from_file_location("with_constants", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setitem(sys.modules, "with_constants", module)
    assert drawn() == before
