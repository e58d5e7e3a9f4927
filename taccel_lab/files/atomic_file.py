# SPDX-License-Identifier: Apache-2.0
"""Files that appear whole or not at all, or change places; and JSON."""

from __future__ import annotations

import ctypes
import errno
import hashlib
import io
import json
import math
import os
import secrets
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import is_of_a_file
from taccel_lab.processes.cache_place import cache_folder

_ROOM_BYTES = 4096
"""A block: what a disk that is full has not left."""


@contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a temporary file name (same suffix, same folder) renamed to ``target`` on success."""
    target = Path(target)
    if target.is_dir():
        raise OSError(errno.EISDIR, "is a folder; name a file", str(target))
    with parents_made(target):
        staging = hidden_name(target.parent, f".{target.stem}.", target.suffix)
        try:
            # Not by tempfile, whose files are their owner's alone: the user's umask decides.
            staging.touch(exist_ok=False)
        except OSError as error:
            # By the name that somebody gave, not by the hidden one.
            raise OSError(error.errno, error.strerror, str(target)) from error
        try:
            with errors_named(staging, target):
                yield staging
                os.replace(staging, target)
        finally:
            staging.unlink(missing_ok=True)


def hidden_name(folder: Path, prefix: str, suffix: str = "") -> Path:
    """A path in ``folder`` that nothing has yet: eight letters drawn by lot behind ``prefix``."""
    return folder / f"{prefix}{secrets.token_urlsafe(6)}{suffix}"


@contextmanager
def parents_made(target: Path) -> Iterator[None]:
    """Make the folders above ``target``; those that are new go again where the block fails."""
    new = [path for path in target.parents if not os.path.exists(path)]
    try:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise OSError(errno.ENOTDIR, "part of this path is a file", str(target)) from error
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(target)) from error
        yield
    except BaseException:
        for path in new:
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def errors_named(staging: Path, target: Path) -> Iterator[None]:
    """Tell errors of files by the name that somebody gave, ``target``, where they have none, or one
    at or below ``staging``: Python tells of a full disk without a name, and copying by those of
    both files. Where there is room at ``staging``, it is the cache or the temporary folder, where
    libraries write, too, that is full."""
    try:
        yield
    except OSError as error:
        names = [name for name in (error.filename, error.filename2) if name is not None]
        places = [Path(os.fsdecode(name)) for name in names]
        inside = any(staging in (place, *place.parents) for place in places)
        if not is_of_a_file(error) or (places and not inside):
            raise
        place = target
        if not places and error.errno in (errno.ENOSPC, errno.EDQUOT) and _has_room(staging):
            others = cache_folder(), Path(tempfile.gettempdir())
            place = next((other for other in others if not _has_room(other)), target)
        named = OSError(error.errno, error.strerror, str(place))
        for note in getattr(error, "__notes__", ()):
            named.add_note(note)
        raise named from None


def _has_room(place: Path) -> bool:
    """Whether bytes can be written into a folder, or beside a file."""
    folder = next(path for path in (place, *place.absolute().parents) if path.is_dir())
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_ROOM_BYTES))
            file.flush()
    except OSError:
        return False
    return True


def write_by(path: Path | str, write: Callable[[io.BytesIO], object]) -> None:
    """Write a file whole or not at all that a library makes: ``write`` gets a stream in memory.

    Libraries tell of a full disk by errors without its number, by lines on stderr, or by a file
    that is cut short. What Python writes ends in an OSError with number and name.
    """
    memory = io.BytesIO()
    write(memory)
    write_bytes(path, memory.getbuffer())


def write_bytes(path: Path | str, data: bytes | memoryview) -> None:
    """Write a file whole or not at all."""
    with atomic_file(path) as staging:
        staging.write_bytes(data)


def eight_bit(levels: np.ndarray) -> np.ndarray:
    """Levels 0..255 rounded to bytes, same shape; NaN becomes white."""
    return np.nan_to_num(np.clip(np.rint(levels), 0, 255), nan=255.0).astype(np.uint8)


def write_image(path: Path, levels: np.ndarray, parameters: Sequence[int] = ()) -> None:
    """Write RGB or grey levels 0..255, whole or not at all.

    The suffix says the format, ``parameters`` are OpenCV's, whose own writer ends the process at a
    path that is not UTF-8.
    """
    write_bytes(path, image_file(levels, path.suffix, parameters))


def image_file(levels: np.ndarray, suffix: str, parameters: Sequence[int] = ()) -> bytes:
    """RGB or grey levels 0..255 as a file's bytes; arguments as of ``write_image``."""
    import cv2

    image = eight_bit(levels)
    if image.ndim == 3:
        image = np.ascontiguousarray(image[..., ::-1])
    done, data = cv2.imencode(suffix, image, list(parameters))
    if not done:
        raise ValueError(f"OpenCV makes no {suffix} of an image of shape {levels.shape}")
    return data.tobytes()


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


_AT_FDCWD = -100
_SWAP = 2
"""RENAME_EXCHANGE of Linux's renameat2 and RENAME_SWAP of macOS's renamex_np."""
_UNABLE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EXDEV, errno.EPERM}
"""What systems and file systems answer that cannot exchange."""


def exchange(one: Path, other: Path) -> bool:
    """Let two existing paths of one file system change places.

    Returns whether they did; False where the system or the file system has no such call (NFS and
    other network drives, some containers), and nothing has changed. Raises OSError as
    ``os.rename`` does; FileNotFoundError when either is absent.
    """
    swap = _system_call()
    if swap is None or swap(os.fsencode(one), os.fsencode(other)) == 0:
        return swap is not None
    code = ctypes.get_errno()
    if code in _UNABLE:
        return False
    raise OSError(code, os.strerror(code), str(one), None, str(other))


@cache
def _system_call() -> Any:
    """The call of this system with two names, 0 for success; None where there is none."""
    library = ctypes.CDLL(None, use_errno=True)
    names = [ctypes.c_char_p, ctypes.c_char_p]
    if sys.platform == "darwin" and hasattr(library, "renamex_np"):
        call = library.renamex_np
        call.argtypes = [*names, ctypes.c_uint]
        return lambda one, other: call(one, other, _SWAP)
    if hasattr(library, "renameat2"):
        call = library.renameat2
        call.argtypes = [ctypes.c_int, names[0], ctypes.c_int, names[1], ctypes.c_uint]
        return lambda one, other: call(_AT_FDCWD, one, _AT_FDCWD, other, _SWAP)
    return None
