# SPDX-License-Identifier: Apache-2.0
"""Outputs that appear whole or not at all: written under a temporary name, then renamed."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError

OUTPUT_MARKER = ".taccel_lab_output"
"""Empty file in every folder that a command wrote: only such folders are ever replaced."""


def require_replaceable(target: Path | str) -> None:
    """Refuse an output folder that exists, is not empty and was not written by a command.

    Commands call this first, before any long work.
    """
    target = _folder_path(target)
    if target.is_dir() and any(target.iterdir()) and not (target / OUTPUT_MARKER).exists():
        raise InputError(
            f"{target} holds files that taccel-lab did not write; name a new or empty folder"
        )


def _folder_path(target: Path | str) -> Path:
    """The path, absolute where it goes through "." or ".."; refused where a file is in the way."""
    target = Path(target)
    if not target.name or ".." in target.parts:
        target = Path(os.path.abspath(target))
    for path in (target, *target.parents):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} is a file; an output folder is needed")
    return target


@contextmanager
def atomic_directory(target: Path | str, *, own: bool = False) -> Iterator[Path]:
    """Yield a temporary folder that replaces ``target`` when the block ends without an error.

    An earlier folder at ``target`` stays untouched until then and is removed only after the new
    one stands. A file, or a folder with files of somebody else, is refused; ``own`` says that the
    caller has already made sure of the latter by other means.
    """
    target = _folder_path(target)
    if not own:
        require_replaceable(target)
    new_parents = [path for path in target.parents if not path.exists()]
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        try:
            staging.chmod(0o755)
            if not own:
                (staging / OUTPUT_MARKER).touch()
            yield staging
            _swap(staging, target)
        finally:
            if staging.exists():
                shutil.rmtree(staging)
    except BaseException:
        for path in new_parents:
            if not any(path.iterdir()):
                path.rmdir()
        raise


def _swap(staging: Path, target: Path) -> None:
    """Put ``staging`` in the place of ``target``; an earlier one comes back if that fails."""
    if not target.exists():
        os.replace(staging, target)
        return
    shelf = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    earlier = shelf / target.name
    try:
        os.replace(target, earlier)
        os.replace(staging, target)
    except BaseException:
        if earlier.exists() and not target.exists():
            os.replace(earlier, target)
        raise
    finally:
        shutil.rmtree(shelf)


@contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a temporary file name (same suffix, same folder) renamed to ``target`` on success."""
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    fd, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent)
    os.close(fd)
    staging = Path(name)
    try:
        yield staging
        # Temporary files are their owner's alone; results are for the group, too.
        staging.chmod(0o644)
        os.replace(staging, target)
    finally:
        staging.unlink(missing_ok=True)


def to_jsonable(value: Any) -> Any:
    """Turn numpy values, paths, tuples and non-finite floats (as null) into plain JSON values."""
    if isinstance(value, dict):
        return {str(k): to_jsonable(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_jsonable(v) for v in value]
    if isinstance(value, np.ndarray):
        return to_jsonable(value.tolist())
    if isinstance(value, np.generic):
        return to_jsonable(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def write_json(target: Path | str, value: Any) -> None:
    """Write ``value`` as indented JSON, atomically; NaN and infinities become null."""
    with atomic_file(target) as staging:
        staging.write_text(json.dumps(to_jsonable(value), indent=2, allow_nan=False) + "\n")
