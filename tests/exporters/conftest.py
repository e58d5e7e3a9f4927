# SPDX-License-Identifier: Apache-2.0
"""The profiles that are exported, and one torch thread."""

from __future__ import annotations

import pytest
import torch

from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.profile import catalogue_profile
from tests.exporters.profiles import mini_profile


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def mini() -> SensorProfile:
    return mini_profile()


@pytest.fixture(scope="session")
def digit() -> SensorProfile:
    return catalogue_profile("digit")
