# SPDX-License-Identifier: Apache-2.0
"""Array files: good ones as NumPy reads them, all others a sentence before they take memory."""

from __future__ import annotations

import io
import math
import struct
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz, unpack_npz

ARRAYS = {
    "image": np.arange(60, dtype=np.uint8).reshape(4, 5, 3),
    "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "one": np.array(3.5),
    "text": np.array(["a", "bc"]),
    "big_endian": np.arange(3, dtype=">i4"),
    "flags": np.array([True, False]),
    "none": np.zeros((0, 3)),
    "empty_text": np.array(""),
    "complex": np.array([1 + 2j]),
}


def npy(header: str | bytes, data: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    text = header.encode() if isinstance(header, str) else header
    width = "<H" if version == (1, 0) else "<I"
    return b"\x93NUMPY" + bytes(version) + struct.pack(width, len(text)) + text + data


def header(shape: str, descr: str = "'<f8'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n"


def npz(content: bytes, *more: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive of ``a.npy`` and more members."""
    buffer = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(buffer, "w", method) as archive:
        warnings.simplefilter("ignore")  # Of one name twice.
        for name, data in (("a.npy", content), *more):
            archive.writestr(name, data)
    return buffer.getvalue()


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_good_files_are_read_as_numpy_does(save: object, tmp_path: Path) -> None:
    save(tmp_path / "a.npz", **ARRAYS)  # type: ignore[operator]
    found = read_npz(tmp_path / "a.npz")
    assert list(found) == list(ARRAYS)
    with np.load(tmp_path / "a.npz") as expected:
        for name, array in found.items():
            assert array.dtype == expected[name].dtype and array.flags.writeable
            assert array.flags.f_contiguous == expected[name].flags.f_contiguous
            np.testing.assert_array_equal(array, expected[name])
    second = io.BytesIO()
    np.lib.format.write_array(second, ARRAYS["image"], version=(2, 0))
    (tmp_path / "two.npz").write_bytes(npz(second.getvalue()))
    np.testing.assert_array_equal(read_npz(tmp_path / "two.npz")["a"], ARRAYS["image"])


def test_only_what_is_needed_is_looked_at(tmp_path: Path) -> None:
    names = np.array([{"a": 1}], dtype=object)
    np.savez(tmp_path / "a.npz", allow_pickle=True, one=np.ones(2), names=names)
    assert list(read_npz(tmp_path / "a.npz", ["one"])) == ["one"]
    with pytest.raises(InputError, match=r"a\.npz lacks two, three; written by me$"):
        read_npz(tmp_path / "a.npz", ["one", "two", "three"], "written by me")
    with pytest.raises(InputError, match=r"a\.npz is not .*: names: it holds values of type obj"):
        read_npz(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "its header is damaged"),
        (b"\x93NUMPY", "its header is damaged"),
        (npy(header("(1000000000000,)")), "declares 7451 GiB"),
        (npy(header("(3,)"), b"x" * 23), "declares 24 bytes .* 23 are there"),
        (npy(header("(3,)"), b"x" * 25), "declares 24 bytes .* 25 are there"),
        (npy(header("(-1,)")), r"shape \(-1,\)"),
        (npy(header("(0, 9" + "9" * 30 + ")")), "the shape"),
        (npy(header("(0, 3000000000, 3000000000)")), "the shape"),
        (npy(header("(" + "1," * 40 + ")"), b"x" * 8), "the shape"),
        (npy(header("(3,)", "'|O'"), b"x" * 24), "values of type object"),
        (npy(header("(3,)", "'<M8[s]'"), b"x" * 24), "values of type datetime"),
        (npy(header("(3,)", "[('a', '<f8')]"), b"x" * 24), "values of type .*'a'"),
        (npy(header("(3,)", "'|V99999999'")), "values of type"),
        (npy(header("(1,)", "'<U400000000'")), "declares 1.49 GiB"),
        (npy(header("(9999999999,)", "'<U0'")), "values of type <U0"),
        (npy(header("(5,)", "'|S0'")), r"values of type \|S0"),
        (npy("{'descr': __import__('os'), 'fortran_order': False, 'shape': ()}"), "damaged"),
        (npy("{" * 200), "damaged"),
        (npy(" " * 60000 + header("()"), b"x" * 8), "damaged"),
        (npy(header("()"), b"x" * 8, (3, 0)), r"version \(3, 0\)"),
        (b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**32 - 1) + b"{}", "damaged"),
    ],
)
def test_damaged_arrays_are_sentences(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(npz(content))
    with pytest.raises(InputError, match=words):
        read_npz(path)


def changed(data: bytes, mark: bytes, offset: int, value: bytes) -> bytes:
    """Bytes with others at ``offset`` behind the last ``mark``."""
    at = data.rindex(mark) + offset
    return data[:at] + value + data[at + len(value) :]


GOOD = npy(header("(100,)"), bytes(800))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no zip archive"),
        (b"PK no archive", "no zip archive"),
        (GOOD, "a single array"),
        (npz(GOOD)[:-30], "no zip archive"),
        (npz(GOOD)[30:], "a"),
        (npz(GOOD, ("a.npy", GOOD)), "holds a twice"),
        (npz(GOOD, ("read.me", b"")), "'read.me', which is no array"),
        (npz(GOOD, method=zipfile.ZIP_LZMA), "another method"),
        (npz(GOOD, method=zipfile.ZIP_BZIP2), "another method"),
        # In the zip's list: flags at 8, method at 10, packed size at 20, size at 24.
        (changed(npz(GOOD), b"PK\x01\x02", 8, b"\x01\x00"), "encrypted"),
        (changed(npz(GOOD), b"PK\x01\x02", 10, b"\x63\x00"), "another method"),
        (changed(npz(GOOD), b"PK\x01\x02", 6, b"\xff\x00"), "zip file version"),
        (changed(npz(GOOD), b"PK\x01\x02", 20, b"\x05\x00"), "is not a readable"),
        (changed(npz(GOOD), b"PK\x01\x02", 24, b"\x05\x00"), "is not a readable"),
        (changed(npz(GOOD), b"PK\x01\x02", 24, b"\xff\xff\xff\xef"), "to 3.75 GiB"),
        (changed(npz(GOOD), b"PK\x01\x02", 16, b"\xff\xff"), "CRC"),
        (changed(npz(GOOD), b"PK\x05\x06", 12, b"\xff\xff\xff\x7f"), "list of contents"),
        (npz(GOOD, method=zipfile.ZIP_STORED).replace(b"NUMPY", b"NUMPI"), "damaged"),
    ],
)  # fmt: skip
def test_damaged_archives_are_sentences(content: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        read_npz(path)
    assert str(caught.value).startswith(f"{path} ")
    with pytest.raises(InputError, match=words):
        unpack_npz(content)


@pytest.mark.thorough
def test_a_small_file_that_unpacks_to_gigabytes_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("a.npy", "w") as member,
    ):
        member.write(npy(header(f"({900 << 17},)")))
        for _ in range(900):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 8 << 20
    tracemalloc.start()
    with pytest.raises(InputError, match="unpacks to 900 MiB; 768 MiB of arrays are allowed"):
        read_npz(path)
    assert tracemalloc.get_traced_memory()[1] < 2 << 20
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("3", "type <U1"),
        (1j, "type complex128"),
        (math.nan, "a is nan"),
        ([1, math.inf], r"a\[1\] is inf"),
    ],
)
def test_numbers_have_to_be_finite(value: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        finite_numbers({"a": np.array(value)}, "a", "f.npz")
    with pytest.raises(InputError, match=r"f\.npz lacks b"):
        finite_numbers({"a": np.array(value)}, "b", "f.npz")
    assert finite_numbers({"a": np.arange(3)}, "a", "f.npz").tolist() == [0, 1, 2]
