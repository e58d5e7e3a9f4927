# SPDX-License-Identifier: Apache-2.0
"""The page that says through which files a press goes, walked by a press."""

from __future__ import annotations

import pytest

import taccel_lab as tl
from tests.support.walked import files_run, stops

MOST_FILES = 175
"""Most of them are the solver's."""


@pytest.mark.thorough
def test_a_press_goes_through_the_files_that_the_page_names() -> None:
    named = stops("A press in twelve stops")
    assert len(named) == 12
    tl.press("flat_pad", "sphere:4", depth_mm=0.2)
    found: list[tl.Press] = []

    def press() -> None:
        found.append(tl.press("flat_pad", "sphere:4", depth_mm=0.25))
        assert found[0].force_interval.low_n < found[0].force_n

    called = files_run(press)
    print(len(called))
    assert set(named) <= set(called) and len(called) <= MOST_FILES
    assert [name for name in called if name in named] == named
