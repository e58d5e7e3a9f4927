# SPDX-License-Identifier: Apache-2.0
"""Values to the digits that their errors leave them."""

from __future__ import annotations

import math

NORMAL_95 = 1.959963984540054
"""Half width of the 95 % interval of a normal distribution, in standard deviations."""
UNSTATED_DIGITS = 4
"""Digits of a value whose error nobody knows."""


def with_error(value: float, error: float | None) -> str:
    """``2.915 +- 0.093``: the error to two digits, the value to the same decimal.

    Where no error is known (None or NaN), or it is 0, the value alone to four digits.
    """
    shown = to_error(value, error)
    decimals = _decimals(error)
    if decimals is None or error is None:
        return shown
    return f"{shown} +- {_fixed(error, decimals)}"


def to_error(value: float, error: float | None) -> str:
    """The value alone, to the decimal of its error's second digit."""
    decimals = _decimals(error)
    if decimals is None:
        # A negative zero has no sign.
        return f"{value + 0.0:.{UNSTATED_DIGITS}g}"
    return _fixed(value, decimals)


def _decimals(error: float | None) -> int | None:
    """Decimal of the second digit of an error, negative left of the point; None without an
    error."""
    if error is None or not math.isfinite(error) or error == 0:
        return None
    # Of the rounded error: 0.0996 is 0.10.
    return 1 - int(f"{error:.1e}".partition("e")[2])


def _fixed(value: float, decimals: int) -> str:
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"
