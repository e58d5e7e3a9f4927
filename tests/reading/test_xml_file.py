# SPDX-License-Identifier: Apache-2.0
"""XML files: what is read, and what is refused with the file's name."""

from __future__ import annotations

from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.reading.xml_file import MAX_DEPTH, XML_LIMIT_BYTES, read_xml


def written(folder: Path, content: bytes) -> Path:
    path = folder / "a.xml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "head", [b"", b"\xef\xbb\xbf", b'<?xml version="1.0" encoding="latin-1"?>', b"<!-- a -->\n"]
)
def test_text_is_utf_8_whatever_the_file_says(tmp_path: Path, head: bytes) -> None:
    root = read_xml(written(tmp_path, head + '<a b="ü"><c/><c/></a>'.encode()), "a URDF file")
    assert (root.tag, root.get("b"), len(root.findall("c"))) == ("a", "ü", 2)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not valid XML: no element found"),
        (b"<a><b></a>", "is not valid XML: mismatched tag: line 1"),
        (b"<a/><b/>", "is not valid XML: junk after document element"),
        (b"<x:a/>", "is not valid XML: unbound prefix"),
        (b"<a>&b;</a>", "is not valid XML: undefined entity"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "has a document type"),
        (b"<a>" * (MAX_DEPTH + 1), "is nested more than 100 deep"),
        (b"<a>\xff</a>", "is not UTF-8 text"),
        (b"<a>\0</a>", "has a NUL byte"),
        ("<a/>".encode("utf-16"), "is UTF-16 text"),
        (b" " * (XML_LIMIT_BYTES + 1), "a URDF file may have up to 16 MiB"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, content: bytes, words: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(InputError, match=words) as error:
        read_xml(path, "a URDF file")
    assert str(path) in str(error.value)


def test_siblings_are_not_depth(tmp_path: Path) -> None:
    path = written(tmp_path, b"<a>" + b"<b><c/></b>" * 1000 + b"</a>")
    assert len(read_xml(path, "a URDF file")) == 1000
