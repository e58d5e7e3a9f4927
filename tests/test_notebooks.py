# SPDX-License-Identifier: Apache-2.0
"""Notebooks are executed, show their results and agree with their scripts."""

from __future__ import annotations

from pathlib import Path

import jupytext
import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"
SCRIPTS = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
"""Those that are notebooks, too; other scripts are run as they are."""


def test_there_are_notebooks() -> None:
    assert SCRIPTS


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_notebook_is_the_executed_script(script: Path) -> None:
    notebook_path = script.with_suffix(".ipynb")
    assert notebook_path.stat().st_size < 600_000
    notebook, source = jupytext.read(notebook_path), jupytext.read(script)
    assert [cell.source for cell in notebook.cells] == [cell.source for cell in source.cells]
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    outputs = [output for cell in code for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    # Warnings, which say paths of the machine that ran it.
    assert not [output for output in outputs if output.get("name") == "stderr"]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 3
