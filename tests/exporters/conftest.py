# SPDX-License-Identifier: Apache-2.0
"""The profiles that are exported, their folders, and one torch thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch

from taccel_lab.exporters.export import export_profile
from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.profile import catalogue_profile
from tests.exporters.profiles import mini_profile, skewed_profile

Exported = Callable[[str], tuple[Path, dict[str, Any]]]


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def mini() -> SensorProfile:
    return mini_profile()


@pytest.fixture(scope="session")
def skewed() -> SensorProfile:
    return skewed_profile()


@pytest.fixture(scope="session")
def digit() -> SensorProfile:
    return catalogue_profile("digit")


@pytest.fixture(scope="session")
def exported(mini: SensorProfile, tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Folder and record of the Mini in a format; not to be changed."""

    @cache
    def made(to: str) -> tuple[Path, dict[str, Any]]:
        out = tmp_path_factory.mktemp(to) / "out"
        return out, export_profile(mini, to, out)

    return made
