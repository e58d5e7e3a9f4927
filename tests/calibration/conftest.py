# SPDX-License-Identifier: Apache-2.0
"""The real presses, where they are installed, and a check that judges equal captures once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from taccel_lab.calibration.capture import CaptureSet, load_captures
from tests.calibration.judged_once import detect_once, judge_slopes_once
from tests.support.real_data import taxim_presses


@pytest.fixture(scope="session")
def taxim_captures() -> CaptureSet:
    return load_captures(taxim_presses())


@pytest.fixture(scope="session", autouse=True)
def _equal_captures_are_judged_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        detect_once(patch)
        judge_slopes_once(patch)
        yield
