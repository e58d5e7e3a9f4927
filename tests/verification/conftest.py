# SPDX-License-Identifier: Apache-2.0
"""With TACCEL_LAB_BESIDE=cuda:0 every step is taken there, too, and compared."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tests.verification.beside import steps_beside

BESIDE = os.environ.get("TACCEL_LAB_BESIDE")


@pytest.fixture(autouse=BESIDE is not None)
def steps_are_taken_beside() -> Iterator[None]:
    """Prints what was compared, for ``pytest -rP``."""
    assert BESIDE is not None
    with steps_beside(BESIDE) as found:
        yield
    print(found)
