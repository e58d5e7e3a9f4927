# SPDX-License-Identifier: Apache-2.0
"""Examples of the docs that need no captures run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = [
    "cad.md",
    "environments.md",
    "gradients.md",
    "meshing.md",
    "newton.md",
    "robots.md",
    "scenes.md",
    "signals.md",
    "tasks.md",
]


@pytest.mark.parametrize("page", PAGES)
def test_examples_run(page: str) -> None:
    if page == "newton.md":
        pytest.importorskip("newton", reason="newton is not installed")
    text = (DOCS / page).read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert blocks
    names: dict[str, object] = {"__name__": page}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
