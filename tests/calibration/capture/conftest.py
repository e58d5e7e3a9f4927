# SPDX-License-Identifier: Apache-2.0
"""Contacts are found once for each picture: most tests spoil a few frames of the same captures."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.calibration.judged_once import detect_once


@pytest.fixture(scope="session", autouse=True)
def equal_frames_are_measured_once() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        detect_once(patch)
        yield
