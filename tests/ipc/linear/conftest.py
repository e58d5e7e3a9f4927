# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the linear solvers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import warp as wp


@pytest.fixture
def many_lanes() -> Iterator[None]:
    """Thread blocks of more than one lane on the CPU."""
    before = wp.config.enable_cpu_blocks
    wp.config.enable_cpu_blocks = True
    yield
    wp.config.enable_cpu_blocks = before
