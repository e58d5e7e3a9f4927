# SPDX-License-Identifier: Apache-2.0
"""NumPy's ``.npz`` and ``.npy`` files: what they declare is checked before anything is unpacked.

Only plain numbers and texts are read, never pickles; whatever is wrong with a file is an
InputError.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_small, require_small_directory
from taccel_lab.files.regular_file import in_bytes, require_regular_file

MAX_ARRAY_BYTES = 768 << 20
"""Most bytes of all arrays of a file together: 800 colour images of 640 x 480 px, and room left in
1 GiB."""
PLAIN_KINDS = "biufcSU"
"""Kinds of NumPy's types that are read: truth values, numbers and texts."""
_CHUNK_BYTES = 1 << 20


def read_npz(
    path: Path | str, needed: Sequence[str] | None = None, hint: str = ""
) -> dict[str, np.ndarray]:
    """Arrays of an ``.npz`` by their names.

    Args:
        path: The file.
        needed: Those that have to be there; no others are looked at. All there are when None.
        hint: What to say besides when some are missing.

    Raises InputError with the path when it is no such file, is damaged, lacks an array, or unpacks
    to more than ``MAX_ARRAY_BYTES``.
    """
    path = require_regular_file(Path(path), MAX_ARRAY_BYTES, "an .npz file of arrays")
    with path.open("rb") as file:
        try:
            return _unpacked(file, needed, hint)
        except InputError as error:
            raise InputError(f"{path} {error}") from None


def unpack_npz(data: bytes) -> dict[str, np.ndarray]:
    """Arrays of an ``.npz`` that is in memory; errors as above, without the path."""
    return _unpacked(io.BytesIO(data), None, "")


def finite_numbers(arrays: Mapping[str, np.ndarray], key: str, path: Path | str) -> np.ndarray:
    """The array of that name, if it is there and holds real, finite numbers."""
    values = arrays.get(key)
    if values is None:
        raise InputError(f"{path} lacks {key}")
    if values.dtype.kind not in "iuf":
        raise InputError(f"{path}: {key} has type {values.dtype}; real numbers are needed")
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        place = tuple(int(i) for i in wrong[0])
        raise InputError(
            f"{path}: {key}{list(place) if place else ''} is {values[place]}; finite numbers are "
            "needed"
        )
    return values


def _unpacked(file: IO[bytes], needed: Sequence[str] | None, hint: str) -> dict[str, np.ndarray]:
    """Arrays of an archive; the errors continue its name."""
    try:
        try:
            require_small_directory(file)
        except InputError as error:
            raise _unreadable(str(error)) from None
        with zipfile.ZipFile(file) as archive:
            members = _members(archive, needed, hint)
            # Each has a header besides.
            room = MAX_ARRAY_BYTES + 1024 * len(members)
            require_small(members.values(), room, "arrays")
            arrays = {}
            for name, member in members.items():
                with archive.open(member) as stream:
                    try:
                        arrays[name] = _array(stream, member.file_size)
                    except InputError as error:
                        raise _unreadable(f"{name}: {error}") from None
            return arrays
    except InputError:
        raise
    # zipfile and zlib have a dozen kinds of error for a damaged archive, and name no list of them.
    except Exception as error:
        raise _unreadable(str(error) or type(error).__name__) from None


def _unreadable(why: str) -> InputError:
    return InputError(f"is not a readable .npz of plain arrays: {why}")


def _members(
    archive: zipfile.ZipFile, needed: Sequence[str] | None, hint: str
) -> dict[str, zipfile.ZipInfo]:
    """The archive's members that are wanted, by the names of their arrays."""
    members: dict[str, zipfile.ZipInfo] = {}
    for member in archive.infolist():
        name = member.filename.removesuffix(".npy")
        if needed is not None and name not in needed:
            continue
        if name == member.filename:
            raise _unreadable(f"it holds {name!r}, which is no array (.npy)")
        if name in members:
            raise _unreadable(f"it holds {name} twice")
        if member.flag_bits & 1:
            raise _unreadable(f"{name} is encrypted")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise _unreadable(f"{name} is compressed by another method than NumPy's")
        members[name] = member
    missing = [name for name in needed or () if name not in members]
    if missing:
        raise InputError(f"lacks {', '.join(missing)}" + (f"; {hint}" if hint else ""))
    return members


def _array(stream: IO[bytes], size: int) -> np.ndarray:
    """The array of a stream of ``size`` bytes, header and all."""
    shape, dtype, fortran, header = _header(stream)
    count = math.prod(shape)
    declared = count * dtype.itemsize
    if declared > MAX_ARRAY_BYTES:
        raise InputError(
            f"its header declares {in_bytes(declared)} ({dtype}, shape {_short(shape)}); "
            f"{in_bytes(MAX_ARRAY_BYTES)} is allowed"
        )
    if header + declared != size:
        raise InputError(
            f"its header declares {declared} bytes ({dtype}, shape {_short(shape)}), "
            f"{max(size - header, 0)} are there"
        )
    flat = np.empty(count, dtype)
    content, at = flat.view(np.uint8), 0
    while at < declared and (chunk := stream.read(min(_CHUNK_BYTES, declared - at))):
        content[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
        at += len(chunk)
    if at < declared or stream.read(1):  # The end is where a zip checks its sums.
        raise InputError(f"{at} of {declared} bytes are there")
    return flat.reshape(shape[::-1]).transpose() if fortran else flat.reshape(shape)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype, bool, int]:
    """Shape, type, order (whether Fortran's) and the header's own size in bytes."""
    from numpy.lib import format as npy

    try:
        version = npy.read_magic(stream)
        if version not in ((1, 0), (2, 0)):  # Later ones are for tables with Greek column names.
            raise InputError(f"its header has the version {version}; 1.0 and 2.0 are allowed")
        width = "<H" if version == (1, 0) else "<I"
        (length,) = struct.unpack(width, stream.read(struct.calcsize(width)))
        text = stream.read(min(length, _CHUNK_BYTES))
        parse = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = parse(io.BytesIO(struct.pack(width, length) + text))
    except InputError:
        raise
    except (zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"it is damaged ({_short(error)})") from None
    # The header is a literal of Python, whose parser has errors of many kinds for programmers.
    except Exception:
        raise InputError("its header is damaged: it is no description of an array") from None
    # NumPy makes texts of no length a byte long, which no file fills.
    if dtype.kind not in PLAIN_KINDS or not dtype.itemsize:
        raise InputError(f"it holds values of type {_short(dtype)}; numbers and texts are allowed")
    if len(shape) > 32 or not all(0 <= int(n) < 2**62 for n in shape):
        raise InputError(f"its header has the shape {_short(shape)}")
    shape = tuple(int(n) for n in shape)
    if 0 in shape and math.prod(n for n in shape if n) >= 2**62:  # NumPy refuses such shapes.
        raise InputError(f"its header has the shape {_short(shape)}")
    return shape, dtype, bool(fortran), len(npy.magic(1, 0)) + struct.calcsize(width) + length


def _short(value: object) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= 80 else text[:80] + "..."
