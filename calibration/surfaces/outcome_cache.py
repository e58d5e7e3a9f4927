# SPDX-License-Identifier: Apache-2.0
"""Outcomes of simulated presses, kept by everything that they depend on.

A batch is kept as a whole: the presses of a batch are searched together, so that only then do a
simulation and what is kept of it agree to the last bit.
"""

from __future__ import annotations

import warnings
import zipfile
from dataclasses import fields
from pathlib import Path

import numpy as np

from taccel_lab.calibration.surfaces.press_batch import BatchOutcome, PressBatch
from taccel_lab.errors import InputError
from taccel_lab.output import CACHE_VARIABLE, atomic_file, cache_folder, content_key
from taccel_lab.version import __version__

RECIPE = 4
"""Raised whenever the same press comes out otherwise."""
_NAMES = tuple(field.name for field in fields(BatchOutcome))


def outcome_path(batch: PressBatch) -> Path:
    """File that the outcome of a batch is kept in."""
    key = content_key({"recipe": RECIPE, "version": __version__, **batch.recipe()})
    return cache_folder() / "presses" / f"{key}.npz"


def kept_outcome(batch: PressBatch) -> BatchOutcome | None:
    """The outcome of an earlier simulation; None without, or when the file is damaged."""
    path = outcome_path(batch)
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            found = BatchOutcome(**{name: stored[name] for name in _NAMES})
        if not all(len(getattr(found, name)) == len(batch.at_mm) for name in _NAMES):
            raise ValueError("it is of another number of presses")
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        warnings.warn(f"kept presses {path} are damaged ({error}): simulated again", stacklevel=2)
        return None
    return found


def keep_outcome(batch: PressBatch, outcome: BatchOutcome) -> None:
    """Keep an outcome; InputError when the cache folder cannot be written."""
    path = outcome_path(batch)
    try:
        with atomic_file(path) as staging:
            np.savez_compressed(staging, **{name: getattr(outcome, name) for name in _NAMES})
    except OSError as error:
        raise InputError(
            f"cannot write the cache of presses {path.parent} ({error.strerror}); set "
            f"{CACHE_VARIABLE} to a folder that can be written"
        ) from error
