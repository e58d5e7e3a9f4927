# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, and JSON."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np


@contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a temporary file name (same suffix, same folder) renamed to ``target`` on success."""
    target = Path(target)
    if target.is_dir():
        raise OSError(errno.EISDIR, "is a folder; name a file", str(target))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        fd, name = tempfile.mkstemp(
            prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent
        )
    except (FileExistsError, NotADirectoryError) as error:
        raise OSError(errno.ENOTDIR, "part of this path is a file", str(target)) from error
    except OSError as error:
        # By the name that somebody gave, not by the hidden one.
        raise OSError(error.errno, error.strerror, str(target)) from error
    os.close(fd)
    staging = Path(name)
    try:
        yield staging
        # Temporary files are their owner's alone; results are for the group, too.
        staging.chmod(0o644)
        os.replace(staging, target)
    except OSError as error:
        raise named_error(error, target) from None
    finally:
        staging.unlink(missing_ok=True)


def named_error(error: OSError, target: Path) -> OSError:
    """``error`` by the name that somebody gave where it has none, and that of a full disk always.

    Python and pyarrow name no file or a hidden one, and numpy says only that it wrote too little.
    """
    number = error.errno
    with suppress(OSError):
        if number is None and shutil.disk_usage(target.parent).free == 0:
            number = errno.ENOSPC
    if number is None or (error.filename is not None and number != errno.ENOSPC):
        return error
    return OSError(number, os.strerror(number), str(target))


def write_image(path: Path, bgr: np.ndarray, parameters: Sequence[int] = ()) -> None:
    """Write an image; the suffix says the format, ``parameters`` are OpenCV's.

    OpenCV's own writer ends the process at a path that is not UTF-8.
    """
    import cv2

    done, data = cv2.imencode(path.suffix, bgr, list(parameters))
    if not done:
        raise OSError(f"{path} could not be written")
    path.write_bytes(data.tobytes())


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


def content_id(content: Any) -> str:
    """Twelve hex digits that stand for ``content``: equal content, equal digits."""
    text = json.dumps(to_jsonable(content), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
