# SPDX-License-Identifier: Apache-2.0
"""A GelSight Mini, and a cache of its presses for all tests of a session."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.calibration.material.gel import Gel
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.profile import catalogue_profile


@pytest.fixture(scope="session")
def press_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty cache, so that every session simulates what it tests, once."""
    folder = tmp_path_factory.mktemp("presses")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(folder))
        yield folder


@pytest.fixture(scope="session")
def mini() -> SensorProfile:
    return catalogue_profile("gelsight_mini")


@pytest.fixture(scope="session")
def gel(mini: SensorProfile) -> Gel:
    return Gel.of_profile(mini)
