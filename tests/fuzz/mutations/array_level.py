# SPDX-License-Identifier: Apache-2.0
"""Damage to NumPy's files and to safetensors: claimed sizes, types, archives, and values."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
import zlib

import numpy as np

from tests.fuzz.mutations import byte_level
from tests.fuzz.mutations.draw import Draw, Surroundings
from tests.fuzz.mutations.text_level import json_value

_SHAPES = (
    "()", "(0,)", "(1,)", "(-1,)", "(10000000000,)", "(1000000000000, 1000000)", "(400000000,)",
    "(3, 0)", "(" + "1," * 70 + ")", "(1.5,)", "(True,)", "None", "'x'", "[2, 2]", "(2, 3, 4)",
    "(99999999999999999999999,)",
)  # fmt: skip
_TYPES = (
    "'<f8'", "'<f4'", "'>i2'", "'|u1'", "'|b1'", "'|O'", "'<U1000000'", "'<c16'", "'<M8[s]'",
    "'|V10'", "'|S0'", "[('a', '<f8')]", "'<f2'", "'x'", "3", "None", "'<m8[generic]'", "'<U0'",
)  # fmt: skip
_KINDS = (
    "float64", "float32", "float16", "int64", "uint8", "bool", "complex128", "str", "bytes", "int8",
    "uint64", "longdouble", "datetime64[s]",
)  # fmt: skip
_HEADERS = (
    "{" * 500, "(" * 90 + ")" * 90, "{'descr': '<f8'}", "9" * 9000, "x" * 70_000, "", "\0",
    "__import__('os')", "{'descr': '<f8', 'fortran_order': 3, 'shape': (1,)}",
)  # fmt: skip

_UNPACKED = 1 << 26
"""Bytes of a member that is changed."""


def _npy(header: str, data: bytes, version: int = 1) -> bytes:
    text = header.encode("latin-1", errors="replace") + b"\n"
    size = struct.pack("<H" if version == 1 else "<I", len(text) & (0xFFFF if version == 1 else -1))
    return b"\x93NUMPY" + bytes([version, 0]) + size + text + data


def npy_header(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another header: shape, type, order, version, length, or none that is one."""
    if not data.startswith(b"\x93NUMPY") or len(data) < 12:
        return byte_level.flip(data, draw, around)
    length = struct.unpack("<H", data[8:10])[0]
    header, content = data[10 : 10 + length].decode("latin-1"), data[10 + length :]
    way = draw.below(7)
    if way == 0:
        begin = header.find("'shape': ") + len("'shape': ")
        return _npy(header[:begin] + draw.pick(_SHAPES) + ", }", content)
    if way == 1:
        end = header.find(", 'fortran_order'")
        return _npy("{'descr': " + draw.pick(_TYPES) + header[end:], content)
    if way == 2:
        return _npy(draw.pick(_HEADERS), content)
    if way == 3:
        return data[:6] + bytes([draw.pick((0, 2, 3, 9, 255)), draw.below(3)]) + data[8:]
    if way == 4:
        return data[:8] + struct.pack("<H", draw.pick((0, 1, 65535, 60))) + data[10:]
    if way == 5:
        pickled = pickle.dumps(np.array([{"a": 1}], dtype=object))
        return _npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", pickled)
    return _npy(header.replace("False", draw.pick(("True", "None", "0"))).rstrip(), content)


def array(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another array in a sound file: type, shape, or single values."""
    try:
        values = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception:  # Damaged before, in whatever way.
        return npy_header(data, draw, around)
    buffer = io.BytesIO()
    with np.errstate(all="ignore"):
        np.save(buffer, _changed(np.asarray(values), draw), allow_pickle=False)
    return buffer.getvalue()


def _changed(values: np.ndarray, draw: Draw) -> np.ndarray:
    way = draw.below(5)
    if way == 0:
        name = draw.pick(_KINDS)
        try:
            return values.astype(name)
        except (ValueError, TypeError):
            return values.astype(str)
    if way == 1:
        flat = values.ravel()
        shapes = (
            flat, values[None], values.T, values[..., None], values[:0] if values.ndim else values,
            np.float64(1.0), np.zeros((0, 3)), np.zeros((3, 0)), flat[:1], np.zeros(7),
            np.concatenate([flat, flat]),
        )  # fmt: skip
        return np.asarray(draw.pick(shapes))
    if way == 2 or values.size == 0 or values.dtype.kind not in "iufb":
        return np.zeros_like(values) if draw.chance(0.5) else np.flip(values)
    changed = values.astype(np.float64) if draw.chance(0.3) else values.copy()
    real = (np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1e30, 1e-300)
    whole = (-1, 0, 2**31 - 1, -(2**31), 255, 10**9, 1)
    if changed.dtype.kind == "f":
        value: float = draw.pick(real)
    else:
        value = draw.pick(whole)
        if changed.dtype.kind in "ui":
            info = np.iinfo(changed.dtype)
            value = min(max(value, info.min), info.max)
    flat = changed.reshape(-1) if changed.flags.c_contiguous else changed.ravel()
    if way == 3:
        flat[draw.below(flat.size)] = value
    else:
        flat[:] = value
    return flat.reshape(values.shape)


def member(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """A sound archive with a damaged array, one too few, one more, or another name."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as pack:
            # A bomb stays packed: its 3 GiB would cost 20 s.
            small = all(info.file_size <= _UNPACKED for info in pack.infolist())
            members = {name: pack.read(name) for name in pack.namelist()} if small else {}
    except Exception:  # Damaged before, in whatever way.
        members = {}
    if not members:
        return byte_level.flip(data, draw, around)
    name = draw.pick(sorted(members))
    way = draw.below(12)
    if way == 0:
        del members[name]
    elif way == 1:
        new = ("../x.npy", "x.npy", "x", "/x.npy", "", "a/b.npy", name.upper(), "self.npy")
        members[draw.pick(new)] = members.pop(name)
    elif way == 2:
        members[draw.pick(("x.npy", "readme.txt", "../y.npy", "model_config.npy"))] = members[name]
    elif way == 3:
        members[name] = draw.pick((*byte_level.MUTATORS,))(members[name], draw, around)
    elif way <= 6:
        members[name] = npy_header(members[name], draw, around)
    else:
        members[name] = array(members[name], draw, around)
    return _pack(members, draw.pick((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))


def _pack(members: dict[str, bytes], method: int) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as pack:
        for name, content in members.items():
            pack.writestr(zipfile.ZipInfo(name or "_"), content, method)
    return buffer.getvalue()


def archive(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Other claims of an archive about its members: flags, method, sizes, offsets."""
    heads = [(b"PK\x01\x02", {8: "H", 10: "H", 16: "I", 20: "I", 24: "I", 28: "H", 42: "I"}),
             (b"PK\x03\x04", {6: "H", 8: "H", 14: "I", 18: "I", 22: "I", 26: "H"}),
             (b"PK\x05\x06", {8: "H", 10: "H", 12: "I", 16: "I", 20: "H"})]  # fmt: skip
    mark, fields = draw.pick(heads)
    place = data.find(mark)
    if place < 0:
        return byte_level.flip(data, draw, around)
    for _ in range(draw.below(3)):
        place = max(place, data.find(mark, place + 4))
    offset = draw.pick(sorted(fields))
    form = "<" + fields[offset]
    value = draw.pick((0, 1, 8, 9, 12, 14, 99, 0x41, 0xFFFF, 0xFFFFFFFF, 0x7FFFFFFF, 1 << 30))
    packed = struct.pack(form, value & (0xFFFF if form == "<H" else 0xFFFFFFFF))
    return data[: place + offset] + packed + data[place + offset + len(packed) :]


def bomb(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """An array of 3 GiB zeros in 3 MB, or one that only claims so."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as pack:
            name = draw.pick(sorted(pack.namelist()) or ["x.npy"])
    except Exception:  # Damaged before, in whatever way.
        name = "x.npy"
    count = 3 << 30
    head = _npy(f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({count},), }}", b"")
    press = zlib.compressobj(9, zlib.DEFLATED, -15)
    begin = press.compress(head) + press.flush(zlib.Z_FULL_FLUSH)
    block = press.compress(bytes(1 << 20)) + press.flush(zlib.Z_FULL_FLUSH)
    stream = begin + block * (3072 if draw.chance(0.5) else 3) + press.flush()
    return _deflated(name, stream, len(head) + count)


def _deflated(name: str, stream: bytes, size: int) -> bytes:
    """An archive of one member whose stream is there already; its check sum is not."""
    file = name.encode()
    about = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 33, 0, len(stream), size, len(file), 0)
    local = b"PK\x03\x04" + about + file + stream
    central = b"PK\x01\x02" + struct.pack("<H", 20) + about + struct.pack("<HHHII", 0, 0, 0, 0, 0)
    central += file
    end = struct.pack("<HHHHIIH", 0, 0, 1, 1, len(central), len(local), 0)
    return local + central + b"PK\x05\x06" + end


def tensors(data: bytes, draw: Draw, around: Surroundings) -> bytes:
    """Another header of a safetensors file: names, types, shapes, offsets, its length."""
    if len(data) < 8:
        return byte_level.insert(data, draw, around)
    length = struct.unpack("<Q", data[:8])[0]
    header, content = data[8 : 8 + length], data[8 + length :]
    if draw.chance(0.2):
        claims = (0, 1, length + 1, 1 << 40, (1 << 64) - 1, length - 1)
        return struct.pack("<Q", draw.pick(claims)) + data[8:]
    if draw.chance(0.3):
        types = (b"F64", b"I64", b"BF16", b"F16", b"BOOL", b"F8_E4M3", b"U8")
        header = header.replace(b"F32", draw.pick(types), 1)
    elif draw.chance(0.4) and len(content) >= 4:
        place = draw.below(len(content) // 4) * 4
        real = struct.pack("<f", draw.pick((float("nan"), float("inf"), 3e38, 0.0)))
        content = content[:place] + real + content[place + 4 :]
    else:
        header = json_value(header, draw, around)
    return struct.pack("<Q", len(header)) + header + content


MUTATORS = {
    ".npy": (npy_header, npy_header, array),
    ".npz": (member, member, member, member, archive, bomb),
    ".safetensors": (tensors, tensors, tensors),
}
