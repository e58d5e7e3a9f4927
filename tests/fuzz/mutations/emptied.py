# SPDX-License-Identifier: Apache-2.0
"""A file of which a part, or all, is empty: no rows, frames, faces, entries or letters."""

from __future__ import annotations

import io
import json
import re
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
import pyarrow.parquet as pq
import tomli_w

Way = tuple[str, bytes]
"""What is empty, and the file that is left."""


def emptied(path: Path) -> Iterator[Way]:
    """The ways in which a sound file may hold nothing, by its ending."""
    data = path.read_bytes()
    yield "no bytes", b""
    yield from _OF_A_FORMAT.get(path.suffix, lambda _: ())(data)


def _lines(data: bytes) -> Iterator[Way]:
    yield "its first line", data.splitlines(keepends=True)[0]
    yield "blank lines", b"\n\n"


def _json(data: bytes) -> Iterator[Way]:
    yield "null", b"null"
    for words, document in _documents(json.loads(data)):
        yield words, json.dumps(document).encode()


def _toml(data: bytes) -> Iterator[Way]:
    try:
        whole = tomllib.loads(data.decode())
    except tomllib.TOMLDecodeError:  # A word stands for what nobody reads of a sample.
        return
    for words, document in _documents(whole):
        yield words, tomli_w.dumps(document).encode()


def _documents(whole: Any) -> Iterator[tuple[str, Any]]:
    """The document with one list, table or text after the other empty."""
    for place in _places(whole):
        document = deepcopy(whole)
        if not place:
            yield "nothing", type(document)()
            continue
        above = document
        for key in place[:-1]:
            above = above[key]
        above[place[-1]] = type(above[place[-1]])()
        yield f"no {'.'.join(map(str, place))}", document


def _places(node: Any) -> Iterator[tuple[Any, ...]]:
    if not isinstance(node, (dict, list, str)):
        return
    if node:
        yield ()
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in () if isinstance(node, str) else items:
        yield from ((key, *rest) for rest in _places(value))


def _arrays(data: bytes) -> Iterator[Way]:
    with np.load(io.BytesIO(data)) as pack:
        arrays = {name: pack[name] for name in pack.files}
    for chosen in (*arrays, None):
        left = {n: a[:0] if a.ndim and chosen in (n, None) else a for n, a in arrays.items()}
        yield f"no rows of {chosen or 'any array'}", _npz(left)
    yield "no arrays", _npz({})


def _npz(arrays: dict[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _parquet(data: bytes) -> Iterator[Way]:
    table, buffer = pq.read_table(io.BytesIO(data)), io.BytesIO()
    pq.write_table(table.slice(0, 0), buffer)
    yield "no rows", buffer.getvalue()
    buffer = io.BytesIO()
    pq.write_table(table.select([]), buffer)
    yield "no columns", buffer.getvalue()


def _hdf5(data: bytes) -> Iterator[Way]:
    names: list[str] = []
    with h5py.File(io.BytesIO(data), "r") as file:
        file.visititems(lambda name, item: names.append(name) if hasattr(item, "shape") else None)
    for name in names:
        buffer = io.BytesIO(data)
        with h5py.File(buffer, "r+") as file:
            kind, shape = file[name].dtype, file[name].shape
            del file[name]
            file.create_dataset(name, (0, *shape[1:]), kind)
        yield f"no rows of {name}", buffer.getvalue()
    buffer = io.BytesIO()
    h5py.File(buffer, "w").close()
    yield "no groups", buffer.getvalue()


def _xml(data: bytes) -> Iterator[Way]:
    for number, element in enumerate(ElementTree.fromstring(data).iter()):
        root = ElementTree.fromstring(data)
        chosen = [*root.iter()][number]
        if len(chosen) or (chosen.text or "").strip():
            del chosen[:]
            chosen.text = ""
            yield f"no content of {element.tag} {number}", ElementTree.tostring(root)
        for name in element.attrib:
            kept = chosen.attrib[name]
            chosen.attrib[name] = ""
            yield f"no {name} of {element.tag} {number}", ElementTree.tostring(root)
            chosen.attrib[name] = kept


def _zip(data: bytes) -> Iterator[Way]:
    """Archives of XML."""
    with zipfile.ZipFile(io.BytesIO(data)) as pack:
        members = {name: pack.read(name) for name in pack.namelist()}
    for name in members:
        ways = _xml(members[name]) if members[name].lstrip().startswith(b"<") else ()
        for words, content in (("no bytes", b""), *ways):
            yield f"{name}: {words}", _packed(members | {name: content})
    yield "no members", _packed({})


def _packed(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as pack:
        for name, content in members.items():
            pack.writestr(name, content)
    return buffer.getvalue()


def _stl(data: bytes) -> Iterator[Way]:
    yield "no faces in bytes", bytes(84)
    yield "no faces in words", b"solid x\nendsolid x\n"


def _ply(data: bytes) -> Iterator[Way]:
    head, mark, _ = data.partition(b"end_header\n")
    yield "no rows below its header", head + mark
    yield "no vertices and faces", re.sub(rb"(element \w+) \d+", rb"\1 0", head) + mark


def _sections(data: bytes) -> Iterator[Way]:
    """Gmsh's and STEP's sections: each without what stands in it."""
    begin = re.compile(rb"(?ms)^(\$\w+|DATA;|HEADER;)\n(.*?)^(\$End\w+|ENDSEC;)")
    for match in begin.finditer(data):
        yield f"no content of {match[1].decode()}", data[: match.start(2)] + data[match.end(2) :]
        zero = data[: match.start(2)] + b"0\n" + data[match.end(2) :]
        yield f"a count of 0 in {match[1].decode()}", zero


def _avi(data: bytes) -> Iterator[Way]:
    yield "no frames", data[: data.find(b"movi") + 4]


def _mp4(data: bytes) -> Iterator[Way]:
    yield "no frames", data[: data.find(b"mdat") + 4]


_OF_A_FORMAT: dict[str, Callable[[bytes], Iterator[Way]]] = {
    **dict.fromkeys((".csv", ".obj", ".yaml", ".jsonl", ".vtk", ".usda"), _lines),
    **dict.fromkeys((".msh", ".step"), _sections),
    **dict.fromkeys((".urdf", ".xml", ".dae", ".vtu"), _xml),
    ".json": _json,
    ".toml": _toml,
    ".npz": _arrays,
    ".parquet": _parquet,
    ".hdf5": _hdf5,
    ".3mf": _zip,
    ".stl": _stl,
    ".ply": _ply,
    ".avi": _avi,
    ".mp4": _mp4,
}
