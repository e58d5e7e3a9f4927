# SPDX-License-Identifier: Apache-2.0
"""Guards that word themselves: numbers within bounds, names that are known, shapes of arrays."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from typing import Any

import numpy as np

from taccel_lab.errors import InputError

_LISTED = 12
"""Most known names that a refusal lists; of more it gives the nearest, and what lists them."""
_PART = 3
"""Least letters by which part of a name stands for it."""


def require_range(
    name: str, values: float | Sequence[float], low: float, high: float, unit: str = ""
) -> None:
    """Refuse a number, or one of several, that is not finite or lies outside ``low``..``high``.

    Raises InputError with the name, the bounds and the number.
    """
    for value in values if isinstance(values, Sequence) else (values,):
        if math.isfinite(value) and low <= value <= high:
            continue
        unit = f" {unit}" if unit else ""
        bounds = f"lie in [{low:g}, {high:g}]{unit}"
        if math.isinf(high):
            bounds = f"be at least {low:g}{unit}" if value < low else "be finite"
        raise InputError(f"{name} must {bounds}, got {value:g}")


def require_positive(name: str, value: float, unit: str = "") -> None:
    """Refuse a number that is zero, negative or not finite. Raises InputError."""
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} must be positive and finite, got {value:g}{unit and f' {unit}'}")


def require_known(what: str, name: str, known: Iterable[str], listed_by: str = "") -> None:
    """Refuse a name that is not ``known``. Raises InputError as of ``unknown``."""
    known = list(known)
    if name not in known:
        raise InputError(f"no {what} {name!r}{unknown(name, known, listed_by)}")


def unknown(
    name: str, known: Iterable[str], listed_by: str = "", *, they_are: str = "known"
) -> str:
    """The nearest known name, then all of them where they are few, to end a refusal with.

    ``listed_by``: the command that lists them, in place of many names, and of all where one is
    near; ``they_are``: what the list calls them.
    """
    known = list(known)
    meant = nearest(name, known)
    if not known:
        return "; there are none"
    if listed_by and (meant or len(known) > _LISTED):
        return f"{meant}; {listed_by} lists all {len(known)}"
    if len(known) <= _LISTED:
        return f"{meant}; {they_are}: {', '.join(known)}"
    return meant or f"; {they_are}: {', '.join(known)}"


def nearest(name: str, known: Iterable[str]) -> str:
    """`` (did you mean NAME?)`` for the most similar known name, or nothing."""
    found = _closest(name, known)
    return f" (did you mean {found}?)" if found else ""


def _closest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is meant most likely, however its words are capitalised and joined."""
    plain = {_plain(each): each for each in known}
    word = _plain(name)
    # Part of a name, such as ``mini``, is less like it than other short names are.
    whole = [each for each in plain if len(word) >= _PART and word in each]
    for found in (
        get_close_matches(word, plain, n=1, cutoff=0.75),
        sorted(whole, key=len)[:1],
        get_close_matches(word, plain, n=1, cutoff=0.6),
    ):
        if found:
            return plain[found[0]]
    return None


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", str(name).lower())


def require_shape(
    name: str, array: Any, *shapes: tuple[int | str, ...], finite: bool = True
) -> None:
    """Refuse an array of none of the ``shapes``, a word in which stands for any length.

    Raises InputError with the shapes and the one found, or that numbers are not finite.
    """
    found = np.shape(array)
    if not any(
        len(shape) == len(found)
        and all(isinstance(a, str) or a == b for a, b in zip(shape, found, strict=True))
        for shape in shapes
    ):
        allowed = " or ".join(f"[{', '.join(map(str, shape))}]" for shape in shapes)
        raise InputError(f"{name} must have shape {allowed}, got {list(found)}")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{name} holds NaN or infinite values")


def require_size(
    name: str, found_px: Sequence[int], other: str, wanted_px: Sequence[int], advice: str = ""
) -> None:
    """Refuse an image of another width and height [px] than ``other`` has.

    Raises InputError with both sizes, and what to do.
    """
    if tuple(found_px) != tuple(wanted_px):
        raise InputError(
            f"{name} is {found_px[0]}x{found_px[1]} px, {other} {wanted_px[0]}x{wanted_px[1]} px; "
            + (advice or "both have to be of one size")
        )


MOST_SEED = 2**63 - 1
"""What NumPy's and torch's generators both take."""


def require_seed(seed: int) -> None:
    """InputError for a seed that no generator takes, which would fail late in its own words."""
    if not 0 <= seed <= MOST_SEED:
        raise InputError(f"seed must lie in 0..{MOST_SEED}, got {seed}")


def parse_words(items: Sequence[str]) -> dict[str, str]:
    """Read ``name=value`` words into a dict; raise InputError on any other form or a repeat."""
    result: dict[str, str] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{item!r} is not of the form name=value")
        if name.strip() in result:
            raise InputError(f"{name.strip()} is set twice")
        result[name.strip()] = value.strip()
    return result
