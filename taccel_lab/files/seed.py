# SPDX-License-Identifier: Apache-2.0
"""Seeds that are given."""

from __future__ import annotations

from taccel_lab.errors import InputError

MOST_SEED = 2**63 - 1
"""What NumPy's and torch's generators both take."""


def require_seed(seed: int) -> None:
    """InputError for a seed that no generator takes, which would fail late in its own words."""
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"seed must lie in 0..{MOST_SEED}, got {seed}")
