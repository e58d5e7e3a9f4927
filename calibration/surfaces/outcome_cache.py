# SPDX-License-Identifier: Apache-2.0
"""Outcomes of simulated presses, kept by everything that they depend on.

A batch is kept as a whole: the presses of a batch are searched together, so that only then do a
simulation and what is kept of it agree to the last bit.
"""

from __future__ import annotations

from typing import BinaryIO

from taccel_lab.calibration.surfaces.press_batch import BatchOutcome, PressBatch
from taccel_lab.files.file_cache import CachedFile, load_arrays, save_arrays
from taccel_lab.version import __version__

RECIPE = 5
"""Raised whenever the same press comes out otherwise."""


def kept_outcome(batch: PressBatch) -> CachedFile[BatchOutcome]:
    """The file of the outcome of a batch."""
    count = len(batch.at_mm)

    def load(file: BinaryIO) -> BatchOutcome:
        found = BatchOutcome(**load_arrays(file))
        if not all(len(values) == count for values in vars(found).values()):
            raise ValueError("it is of another number of presses")
        return found

    def save(file: BinaryIO, outcome: BatchOutcome) -> None:
        save_arrays(file, vars(outcome))

    recipe = {"recipe": RECIPE, "version": __version__, **batch.recipe()}
    return CachedFile("presses", recipe, load, save)
