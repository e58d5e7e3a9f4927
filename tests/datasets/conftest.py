# SPDX-License-Identifier: Apache-2.0
"""A small data set that the tests of this folder read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.support.small_data_sets import make, saved_profile


@pytest.fixture(scope="session")
def profile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved_profile(tmp_path_factory.mktemp("sensor") / "pad")


@pytest.fixture(scope="session")
def made(profile: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished data set; not to be changed."""
    root = tmp_path_factory.mktemp("made") / "data"
    assert make(profile, root).complete
    return root


@pytest.fixture
def copied(made: Path, tmp_path: Path) -> Path:
    """One that may be changed."""
    return shutil.copytree(made, tmp_path / "data")
