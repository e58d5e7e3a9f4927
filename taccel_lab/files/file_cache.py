# SPDX-License-Identifier: Apache-2.0
"""Results that are slow to make, kept in files of the user's cache folder.

A file is named by the content key of its recipe, which holds all that the result depends on, and
begins with a digest of its contents: any damage is reported with a warning, and the result is made
again.
"""

from __future__ import annotations

import hashlib
import io
import json
import stat
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable, write_bytes
from taccel_lab.processes.cache_place import CACHE_VARIABLE, cache_folder

LARGEST_BYTES = 1 << 30
"""Most bytes of a file; a mesh of a hundred thousand nodes takes a fortieth of it."""
_HEAD = b"taccel-lab cache\n"

Result = TypeVar("Result")


@dataclass(frozen=True)
class CachedFile(Generic[Result]):
    """The file of one result."""

    what: str
    """Names such results, in the plural; also the name of their folder."""
    recipe: Mapping[str, Any]
    """All that the result depends on: plain values and arrays."""
    load: Callable[[BinaryIO], Result]
    """Reads a result; raises ValueError, KeyError or TypeError when it is something else."""
    save: Callable[[BinaryIO, Result], None]
    """Writes a result."""

    @property
    def path(self) -> Path:
        """Where it is, or would be."""
        return cache_folder() / self.what / f"{content_key(self.recipe)}.cache"

    def exists(self) -> bool:
        """Whether there is a file; a damaged one counts."""
        return self.path.exists()

    def read(self) -> Result | None:
        """What is kept; None without a file, or with a warning when it is damaged."""
        try:
            status = self.path.stat()
            if stat.S_ISFIFO(status.st_mode):  # To open it would wait for ever.
                raise ValueError("it is a pipe")
            if status.st_size > LARGEST_BYTES:
                raise ValueError("far larger than any")
            data = self.path.read_bytes()
            return self.load(io.BytesIO(_checked(data)))
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError, KeyError, TypeError) as error:
            warnings.warn(
                f"kept {self.what} {self.path} are damaged ({error}): made again", stacklevel=3
            )
            return None

    def write(self, result: Result) -> None:
        """Keep a result.

        Raises:
            InputError: The cache folder cannot be written.
        """
        content = io.BytesIO()
        self.save(content, result)
        data = content.getvalue()
        _write(self.what, self.path, _HEAD + hashlib.sha256(data).digest() + data)

    def read_or_make(self, make: Callable[[], Result]) -> Result:
        """What is kept, or else ``make()``, which is then kept where the cache folder can be
        written; a warning says where it cannot."""
        found = None
        with suppress(InputError):
            found = self.read()
        if found is None:
            found = make()
            try:
                self.write(found)
            except InputError as error:
                warnings.warn(f"{self.what} are made anew each time: {error}", stacklevel=2)
        return found


def keep_file(what: str, path: Path) -> Path:
    """A copy of a file, by its name in the cache's folder ``what``, in place of an earlier one.

    Raises:
        InputError: The cache folder cannot be written.
    """
    kept = cache_folder() / what / path.name
    _write(what, kept, path.read_bytes())
    return kept


def _write(what: str, path: Path, data: bytes) -> None:
    try:
        write_bytes(path, data)
    except OSError as error:
        raise InputError(
            f"cannot write the cache of {what} {path.parent} ({error.strerror}); set "
            f"{CACHE_VARIABLE} to a folder that can be written"
        ) from error


def _checked(data: bytes) -> bytes:
    """What follows the head and the digest; ValueError unless the digest is its own."""
    start = len(_HEAD) + hashlib.sha256().digest_size
    digest, content = data[len(_HEAD) : start], data[start:]
    if not data.startswith(_HEAD) or digest != hashlib.sha256(content).digest():
        raise ValueError("its digest is another")
    return content


def cached_arrays(what: str, recipe: Mapping[str, Any]) -> CachedFile[dict[str, np.ndarray]]:
    """The file of a result that is arrays by their names."""
    return CachedFile(what, recipe, load_arrays, save_arrays)


def load_arrays(file: BinaryIO) -> dict[str, np.ndarray]:
    """Arrays of a file by their names."""
    with np.load(file, allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def save_arrays(file: BinaryIO, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by their names."""
    np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


def as_array(values: Any) -> np.ndarray:
    """Plain values as an array of bytes, to be kept beside others."""
    return np.frombuffer(json.dumps(values).encode(), dtype=np.uint8)


def from_array(kept: np.ndarray) -> Any:
    """The plain values of ``as_array``."""
    return json.loads(kept.tobytes())


@cache
def source_digest(*paths: str) -> str:
    """SHA-256 of the Python files that are ``paths`` or below them: other code makes other
    results."""
    digest = hashlib.sha256()
    for path in map(Path, paths):
        for source in [path] if path.is_file() else sorted(path.rglob("*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()


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
