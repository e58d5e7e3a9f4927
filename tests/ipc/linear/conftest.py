# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the linear solvers."""

from __future__ import annotations

import pytest
import warp as wp


@pytest.fixture
def many_lanes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thread blocks of more than one lane on the CPU."""
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", True)
