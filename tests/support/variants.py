# SPDX-License-Identifier: Apache-2.0
"""Cases of a claim that one fast test holds: the rest of them run by ``make slow``."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import pytest


def variants(fast: Iterable[Any], *axes: Iterable[Any]) -> list[Any]:
    """All combinations of ``axes``; those outside of ``fast`` (values, or tuples of them where
    there are several axes) are slow. ValueError for a fast one that no combination is."""
    kept = [one if isinstance(one, tuple) and len(axes) > 1 else (one,) for one in fast]
    combinations = list(product(*axes))
    if any(one not in combinations for one in kept):
        raise ValueError(f"{kept} are not all among the combinations")
    return [
        pytest.param(*values, marks=() if values in kept else pytest.mark.slow)
        for values in combinations
    ]
