# SPDX-License-Identifier: Apache-2.0
"""The page that says through which files a photo goes, walked by a photo."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import FrameType

import pytest

import taccel_lab as tl
from tests.calibration.live.test_live import colored_unit

ROOT = Path(__file__).parents[2]
MOST_FILES = 45


@pytest.mark.thorough
def test_a_photo_goes_through_the_files_that_the_page_names() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    section = page.partition("## A photo in nine stops")[2].partition("\n## ")[0]
    stops = re.findall(r"^\| .+ \| `taccel_lab/reading/(\w+\.py)` \|$", section, re.MULTILINE)
    assert len(stops) == 9
    profile, rest, images = colored_unit()
    tl.read(profile, images[0], background=rest)
    called: list[str] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(ROOT) and ".venv" not in path.parts:
            name = str(path.relative_to(ROOT))
            if name not in called:
                called.append(name)

    sys.setprofile(note)
    try:
        found = tl.read(profile, images[1], background=rest)
    finally:
        sys.setprofile(None)
    assert found.touch.any and found.force_n > 0
    assert {f"taccel_lab/reading/{name}" for name in stops} <= set(called)
    assert len(called) <= MOST_FILES
    first = [name for name in called if Path(name).name in stops][:3]
    assert [Path(name).name for name in first] == stops[:3]
