# SPDX-License-Identifier: Apache-2.0
"""The real presses, where they are installed."""

from __future__ import annotations

import pytest

from taccel_lab.calibration.capture import CaptureSet, find_taxim_pack, load_captures
from taccel_lab.errors import InputError


@pytest.fixture(scope="session")
def taxim_captures() -> CaptureSet:
    try:
        pack = find_taxim_pack()
    except InputError as error:
        pytest.skip(f"the real captures are not there: {error}")
    return load_captures(pack)
