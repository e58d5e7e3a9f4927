# SPDX-License-Identifier: Apache-2.0
"""Results that are slow to make, kept in files of the user's cache folder.

A file is named by the content key of its recipe, which holds all that the result depends on. A
damaged file is reported with a warning, and the result is made again.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.output import atomic_file, to_jsonable

CACHE_VARIABLE = "TACCEL_LAB_CACHE"
"""Environment variable that names the cache folder."""

Result = TypeVar("Result")


@dataclass(frozen=True)
class CachedFile(Generic[Result]):
    """The file of one result."""

    what: str
    """Names such results, in the plural; also the name of their folder."""
    recipe: Mapping[str, Any]
    """All that the result depends on: plain values and arrays."""
    load: Callable[[Path], Result]
    """Reads a file; raises ValueError, KeyError or TypeError when it holds something else."""
    save: Callable[[Path, Result], None]
    """Writes a file."""
    suffix: str = ".npz"

    @property
    def path(self) -> Path:
        """Where it is, or would be."""
        return cache_folder() / self.what / f"{content_key(self.recipe)}{self.suffix}"

    def exists(self) -> bool:
        """Whether there is a file; a damaged one counts."""
        return self.path.exists()

    def read(self) -> Result | None:
        """What is kept; None without a file, or with a warning when it is damaged."""
        path = self.path
        if not path.exists():
            return None
        try:
            return self.load(path)
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
            warnings.warn(
                f"kept {self.what} {path} are damaged ({error}): made again", stacklevel=3
            )
            return None

    def write(self, result: Result) -> None:
        """Keep a result.

        Raises:
            InputError: The cache folder cannot be written.
        """
        path = self.path
        try:
            with atomic_file(path) as staging:
                self.save(staging, result)
        except OSError as error:
            raise InputError(
                f"cannot write the cache of {self.what} {path.parent} ({error.strerror}); set "
                f"{CACHE_VARIABLE} to a folder that can be written"
            ) from error

    def read_or_make(self, make: Callable[[], Result]) -> Result:
        """What is kept, or else ``make()``, which is then kept."""
        found = self.read()
        if found is None:
            found = make()
            self.write(found)
        return found


def cached_arrays(what: str, recipe: Mapping[str, Any]) -> CachedFile[dict[str, np.ndarray]]:
    """The file of a result that is arrays by their names."""
    return CachedFile(what, recipe, load_arrays, save_arrays)


def load_arrays(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a file by their names."""
    with np.load(path, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def save_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by their names."""
    np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]


def cache_folder() -> Path:
    """$TACCEL_LAB_CACHE, or taccel_lab in $XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taccel_lab"


def content_key(recipe: Mapping[str, Any]) -> str:
    """SHA-256 of a recipe of plain values and arrays; equal recipes give equal keys."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            data = np.ascontiguousarray(value)
            digest = hashlib.sha256(data.tobytes()).hexdigest()
            return {"array": digest, "shape": list(data.shape), "dtype": data.dtype.str}
        return to_jsonable(value)

    text = json.dumps({k: plain(v) for k, v in recipe.items()}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
