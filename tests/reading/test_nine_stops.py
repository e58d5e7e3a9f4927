# SPDX-License-Identifier: Apache-2.0
"""The page that says through which files a photo goes, walked by a photo."""

from __future__ import annotations

from typing import Any

import pytest

import taccel_lab as tl
from tests.calibration.live.test_live import colored_unit
from tests.support.walked import files_run, stops

MOST_FILES = 45


@pytest.mark.thorough
def test_a_photo_goes_through_the_files_that_the_page_names() -> None:
    named = stops("A photo in nine stops")
    assert len(named) == 9
    profile, rest, images = colored_unit()
    tl.read(profile, images[0], background=rest)
    read: list[Any] = []
    called = files_run(lambda: read.append(tl.read(profile, images[1], background=rest)))
    assert read[0].touch.any and read[0].force_n > 0
    assert set(named) <= set(called) and len(called) <= MOST_FILES
    assert [name for name in called if name in named][:3] == named[:3]
