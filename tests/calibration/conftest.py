# SPDX-License-Identifier: Apache-2.0
"""A check that judges equal captures once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.calibration.judged_once import detect_once, judge_slopes_once


@pytest.fixture(scope="session", autouse=True)
def _equal_captures_are_judged_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        detect_once(patch)
        judge_slopes_once(patch)
        yield
