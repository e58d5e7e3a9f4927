# SPDX-License-Identifier: Apache-2.0
"""A cache of presses for all tests of a session."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from taccel_lab.files.file_cache import CACHE_VARIABLE


@pytest.fixture(scope="session")
def press_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty cache, so that every session simulates what it tests, once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("presses")))
        yield
