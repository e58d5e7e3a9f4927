# SPDX-License-Identifier: Apache-2.0
"""Outcomes of simulated presses, kept by everything that they depend on.

A batch is kept as a whole: the presses of a batch are searched together, so that only then do a
simulation and what is kept of it agree to the last bit.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from taccel_lab.calibration.kept import read_kept, write_kept
from taccel_lab.calibration.surfaces.press_batch import BatchOutcome, PressBatch
from taccel_lab.output import atomic_file, cache_folder, content_key
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
    return read_kept(outcome_path(batch), lambda path: _read(path, len(batch.at_mm)), "presses")


def keep_outcome(batch: PressBatch, outcome: BatchOutcome) -> None:
    """Keep an outcome; InputError when the cache folder cannot be written."""

    def write(path: Path) -> None:
        with atomic_file(path) as staging:
            np.savez_compressed(staging, **{name: getattr(outcome, name) for name in _NAMES})

    write_kept(outcome_path(batch), write, "presses")


def _read(path: Path, count: int) -> BatchOutcome:
    with np.load(path, allow_pickle=False) as stored:
        found = BatchOutcome(**{name: stored[name] for name in _NAMES})
    if not all(len(getattr(found, name)) == count for name in _NAMES):
        raise ValueError("it is of another number of presses")
    return found
