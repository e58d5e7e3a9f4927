# SPDX-License-Identifier: Apache-2.0
"""Files of the product that a call runs, beside those that a page of the docs names."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[2]


def stops(heading: str) -> list[str]:
    """Files of the table below a heading of docs/architecture.md, in its order."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = page.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    return re.findall(r"^\| .+ \| `(taccel_lab/\w+/\w+\.py)` \|$", section, re.MULTILINE)


def files_run(call: Callable[[], object]) -> list[str]:
    """Files whose functions a call runs, in the order of the first ones."""
    called: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(ROOT) and ".venv" not in path.parts:
            called.setdefault(str(path.relative_to(ROOT)))

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return list(called)
