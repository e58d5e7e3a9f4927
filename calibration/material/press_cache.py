# SPDX-License-Identifier: Apache-2.0
"""Simulated responses kept on disk by the content that made them."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.output import CACHE_VARIABLE, atomic_file, cache_folder, content_key

VERSION = 2
"""Part of every key; raised when the solver or the way of simulating changes forces."""


def is_kept(recipe: Mapping[str, Any]) -> bool:
    """Whether there is a file of ``recipe``; a damaged one counts."""
    return _path(recipe).exists()


def keep(recipe: Mapping[str, Any], made: Mapping[str, np.ndarray]) -> None:
    """Write the arrays of ``recipe`` to the cache; InputError where it cannot be written."""
    path = _path(recipe)
    try:
        with atomic_file(path) as staging, staging.open("wb") as stream:
            np.savez(stream, **made)  # pyright: ignore[reportArgumentType]
    except OSError as error:
        raise InputError(
            f"cannot write the cache {path.parent} ({error.strerror}); set {CACHE_VARIABLE} to a "
            "folder that can be written"
        ) from error


def kept(recipe: Mapping[str, Any], make: Callable[[], dict[str, np.ndarray]]) -> dict:
    """Arrays of ``recipe`` from the cache, or ``make()``, which is then kept.

    A damaged file is reported with a warning and made again.
    """
    path = _path(recipe)
    if path.exists():
        try:
            with np.load(path, allow_pickle=False) as stored:
                return {name: stored[name] for name in stored.files}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            warnings.warn(f"cached response {path} is damaged ({error}): redone", stacklevel=2)
    made = make()
    keep(recipe, made)
    return made


def _path(recipe: Mapping[str, Any]) -> Path:
    return cache_folder() / "responses" / f"{content_key({'version': VERSION, **recipe})}.npz"
