# SPDX-License-Identifier: Apache-2.0
"""The real presses, where they are installed."""

from __future__ import annotations

import pytest

from taccel_lab.calibration.capture import CaptureSet, load_captures
from tests.support.real_data import taxim_presses


@pytest.fixture(scope="session")
def taxim_captures() -> CaptureSet:
    return load_captures(taxim_presses())
