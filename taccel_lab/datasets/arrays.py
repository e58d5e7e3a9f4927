# SPDX-License-Identifier: Apache-2.0
"""Arrays of a part, opened where all that they say of themselves is what ``part`` writes.

A data set may come from anybody, and zarr trusts it: filters of its format 2 may be pickles, which
run code, any codec that is installed may be named, and a few bytes of zstd unpack to gigabytes.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_held
from taccel_lab.files.documents import read_json
from taccel_lab.files.regular_file import in_bytes, shown

if TYPE_CHECKING:
    import zarr

MESHES = "meshes"
CODECS = ("bytes", "crc32c", "zstd")
"""Names in zarr's format 3, of whole arrays and within ``SHARDS``; none of them runs
anything that a file holds."""
SHARDS = "sharding_indexed"
MAX_BLOCK_BYTES = 4 << 30
"""Size of a chunk and of a row: 20 times eight images of 8 megapixels."""
PACKED_TIMES = 1 << 15
"""Multiple of its files that an array of more than a block may have unpacked: zstd's most."""
MAX_ROWS = 1 << 24
"""Rows of an array; a part of 10,000 touches has some hundred thousand steps."""
_TYPE_BYTES = {
    "bool": 1,
    **{f"{sign}int{bits}": bits // 8 for sign in ("", "u") for bits in (8, 16, 32, 64)},
    **{f"float{bits}": bits // 8 for bits in (16, 32, 64)},
}


class Arrays(Mapping[str, Any]):
    """The arrays of the group at ``path`` by their names, opened on demand; its group
    ``meshes`` is a mapping, too.

    Raises InputError for another format, codec or type, and for sizes beyond the limits; errors of
    Python and zarr for what is damaged: LookupError, TypeError and ValueError, and OSError where a
    chunk that is read unpacks to another size than it should.
    """

    def __init__(self, path: Path) -> None:
        _document(path, "group")
        self._path = path
        self._names = sorted(entry.name for entry in path.iterdir() if entry.is_dir())
        self._opened: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._opened:
            path = self._path / name
            self._opened[name] = Arrays(path) if name == MESHES else _array(path)
        return self._opened[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _document(path: Path, kind: str) -> dict[str, Any]:
    """``zarr.json`` of a group or an array; other formats have none."""
    document = read_json(path / "zarr.json")
    if document.get("zarr_format") != 3 or document.get("node_type") != kind:
        raise InputError(f"{path} is no {kind} of zarr's format 3")
    return document


def _array(path: Path) -> zarr.Array[Any]:
    import zarr

    document = _document(path, "array")
    kind, shape = document["data_type"], document["shape"]
    if not isinstance(kind, str) or kind not in _TYPE_BYTES:
        raise InputError(f"{path} holds {shown(kind)}, which is no type of numbers")
    if shape[0] > MAX_ROWS:
        raise InputError(f"{path} has {shape[0]:,} rows; {MAX_ROWS:,} are allowed")
    for what, numbers in (("row", shape[1:]), ("chunk", _chunk_shape(path, document))):
        size = math.prod(numbers) * _TYPE_BYTES[kind]
        if size > MAX_BLOCK_BYTES:
            raise InputError(
                f"a {what} of {path} has {in_bytes(size)}; {in_bytes(MAX_BLOCK_BYTES)} is allowed"
            )
    # Chunks of equal values need not be there, but some of a long recording are.
    stated = math.prod(shape) * _TYPE_BYTES[kind]
    if stated > MAX_BLOCK_BYTES:
        held = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
        require_held(path, "values", stated, held, PACKED_TIMES)
    array: Any = zarr.open_array(path, mode="r", zarr_format=3)
    metadata = replace(array.metadata, codecs=_bounded(array.metadata.codecs))
    return zarr.Array(zarr.AsyncArray(metadata, array.store_path))


def _chunk_shape(path: Path, document: dict[str, Any]) -> list[int]:
    """Shape of what is unpacked at a time; InputError for codecs that are not read."""
    codecs, chunk = document["codecs"], document["chunk_grid"]["configuration"]["chunk_shape"]
    stated = codecs
    if [codec["name"] for codec in codecs] == [SHARDS]:
        inner = codecs[0]["configuration"]
        stated, chunk = [*inner["codecs"], *inner["index_codecs"]], inner["chunk_shape"]
    for codec in stated:
        if codec["name"] not in CODECS:
            raise InputError(
                f"{path} is packed by {shown(codec['name'])}, which is not read; allowed are "
                f"{', '.join(CODECS)}, alone or within {SHARDS}"
            )
    return chunk


def _bounded(codecs: Iterable[Any]) -> tuple[Any, ...]:
    """The same codecs, with a zstd that unpacks what a chunk has, no more."""
    from zarr.codecs import ShardingCodec, ZstdCodec

    class ExactZstd(ZstdCodec):
        """Arrow's, which is given the size; zarr's believes the file."""

        def _decode_sync(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
            import pyarrow as pa

            size = math.prod(chunk_spec.shape) * chunk_spec.dtype.item_size
            packed = pa.py_buffer(chunk_bytes.as_numpy_array())
            chunk = pa.Codec("zstd").decompress(packed, decompressed_size=size)
            return chunk_spec.prototype.buffer.from_bytes(chunk)

        async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
            return await asyncio.to_thread(self._decode_sync, chunk_bytes, chunk_spec)

    def bounded(codec: Any) -> Any:
        if isinstance(codec, ShardingCodec):
            return replace(codec, codecs=tuple(map(bounded, codec.codecs)))
        return ExactZstd() if isinstance(codec, ZstdCodec) else codec

    return tuple(map(bounded, codecs))
