# SPDX-License-Identifier: Apache-2.0
"""TOML, JSON, YAML and XML: what is odd or damaged is refused in a sentence with the file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.json_file import JSON_LIMIT_BYTES, read_json
from taccel_lab.files.plain_values import MAX_DEPTH, MAX_VALUES, number_at
from taccel_lab.files.text_file import read_text, shown
from taccel_lab.files.toml_file import TOML_LIMIT_BYTES, read_toml
from taccel_lab.files.xml_file import MAX_DEPTH as XML_MAX_DEPTH
from taccel_lab.files.xml_file import XML_LIMIT_BYTES, read_xml
from taccel_lab.files.yaml_file import YAML_LIMIT_BYTES, read_yaml
from taccel_lab.printable import printable

Read = Callable[[Path], dict[str, Any]]
READERS: dict[str, Read] = {"toml": read_toml, "json": read_json, "yaml": read_yaml}
LIMITS = {"toml": TOML_LIMIT_BYTES, "json": JSON_LIMIT_BYTES, "yaml": YAML_LIMIT_BYTES}
ALIASES = "a: &a [1, 2]\nb: [*a, *a]\n"


def written(folder: Path, kind: str, content: str | bytes) -> Path:
    path = folder / f"file.{kind}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(folder: Path, kind: str, content: str | bytes) -> str:
    """What is said about the file, without its path, which every sentence begins with."""
    path = written(folder, kind, content)
    with pytest.raises(InputError) as caught:
        READERS[kind](path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < len(str(path)) + 300
    return str(caught.value)[len(str(path)) :]


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("toml", 'a = 1\nb = 0.5\nc = "x"\nd = [true]\n'),
        ("json", '{"a": 1, "b": 0.5, "c": "x", "d": [true]}'),
        ("yaml", "a: 1\nb: 0.5\nc: x\nd: [true]\n"),
    ],
)
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_values(tmp_path: Path, kind: str, text: str, mark: bytes) -> None:
    path = written(tmp_path, kind, mark + text.encode())
    found = READERS[kind](path)
    assert found == {"a": 1, "b": 0.5, "c": "x", "d": [True]}
    assert [type(value) for value in found.values()] == [int, float, str, list]


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'a = "\xe4"\n', r"is not UTF-8 text: byte 0xe4 in line 1"),
        (b"\xef\xbb\xbf# x\n\xff", "is not UTF-8 text: byte 0xff in line 2"),
        (b"a\n\0", "has a NUL byte in line 2"),
        ("a = 1\n".encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
    ],
)
def test_what_is_no_text(tmp_path: Path, kind: str, content: bytes, words: str) -> None:
    assert words in refused(tmp_path, kind, content)


@pytest.mark.parametrize("kind", READERS)
def test_files_of_a_size_that_is_not_sane(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path, kind, "")
    os.truncate(path, LIMITS[kind] + 1)
    with pytest.raises(InputError, match=r"has .*; a \w+ file may have up to \d+ .iB"):
        READERS[kind](path)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("toml", "a = " + "[" * 5000 + "]" * 5000),
        ("toml", "a = " + "{b = " * 5000),
        ("toml", "a." * 5000 + "b = 1"),
        ("toml", "[" + '"a" . ' * 200_000 + "b]"),
        ("toml", "a = " + "[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1)),
        ("json", '{"a": ' + "[" * 100_000),
        ("json", '{"a": ' * 50_000),
        ("json", '{"a": ' * 40 + "1" + "}" * 40),
        ("yaml", "a: " + "[" * 5000),
        ("yaml", "- " * 5000),
        ("yaml", "{a: " * 40 + "1" + "}" * 40),
    ],
)
def test_deep_nesting(tmp_path: Path, kind: str, text: str) -> None:
    assert "nested more than 32 deep" in refused(tmp_path, kind, text)


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("digits", [19, 22, 5000])
def test_whole_numbers_of_many_digits(tmp_path: Path, kind: str, digits: int) -> None:
    text = {"toml": "a = {}", "json": '{{"a": {}}}', "yaml": "a: {}"}[kind].format("9" * digits)
    words = refused(tmp_path, kind, text)
    assert "63 are allowed" in words or "64 bits" in words or "digits" in words


def test_long_hexadecimal_numbers(tmp_path: Path) -> None:
    # Python reads any number of those digits, and then fails to write the number.
    words = refused(tmp_path, "toml", "a = 0x" + "f" * 900)
    assert words == ": a is a whole number of 3600 bits; 63 are allowed"
    assert "line 2 has a number of 1,000 digits" in refused(
        tmp_path, "toml", "\na = 0x" + "f" * 20_000
    )


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("toml", "[b]\na = [1, nan]"),
        ("toml", "[b]\na = [1, -inf]"),
        ("toml", "[b]\na = [1, 1e999]"),
        ("json", '{"b": {"a": [1, 1e999]}}'),
        ("yaml", "b:\n  a: [1, 1e999]"),
    ],
)
def test_numbers_that_are_not_finite(tmp_path: Path, kind: str, text: str) -> None:
    words = refused(tmp_path, kind, text)
    assert words.startswith(": b.a.1 is ") and "a finite number is needed" in words


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        ("toml", "a = 1\na = 2", "is not valid TOML: Cannot overwrite a value"),
        ("toml", "a = 2026-99-99", "is not valid TOML"),
        ("json", '{"a": 1, "b": 2, "a": 3}', "is not valid JSON: the key 'a' stands twice"),
        ("json", '{"a": NaN}', "is not valid JSON: NaN is no number of JSON"),
        ("json", '{"a": "\\ud800"}', "holds half a character"),
        ("json", '{"\\udfff": 1}', "holds half a character"),
        ("json", "[1, 2]", "holds [1, 2]; an object {...} of keys is needed"),
        ("json", '{"a"', "is not valid JSON"),
        ("yaml", ALIASES, "cannot be read as YAML: anchors and aliases are not read"),
        ("yaml", "b: *a", "anchors and aliases are not read"),
        ("yaml", "a: !!python/tuple [1]", "are not read"),
        ("yaml", "a: !!binary aGk=", "tags ('tag:yaml.org,2002:binary') are not read"),
        ("yaml", "a: 1\nb: 2\na: 3", "the key 'a' stands twice"),
        ("yaml", "[1]: 2", "a list or table as a key is not read"),
        ("yaml", "a: 1\n---\nb: 2", "expected a single document"),
        ("yaml", "just words", "holds 'just words'; a table of keys is needed"),
        ("yaml", 'a: "\\ud800"', "holds half a character"),
        ("yaml", "a: b: c", "mapping values are not allowed"),
    ],
)
def test_other_faults(tmp_path: Path, kind: str, text: str, words: str) -> None:
    assert words in refused(tmp_path, kind, text)


def test_an_alias_bomb_takes_no_memory(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    assert "anchors and aliases" in refused(tmp_path, "yaml", "\n".join(lines))


def test_words_that_yaml_1_1_makes_something_else_of(tmp_path: Path) -> None:
    text = "a: yes\nb: 1:30\nc: 1_000\nd: 2026-11-22\ne: 010\n2: .inf\n<<: x\n"
    assert read_yaml(written(tmp_path, "yaml", text)) == {
        "a": "yes", "b": "1:30", "c": "1_000", "d": "2026-11-22", "e": 10, "2": ".inf", "<<": "x",
    }  # fmt: skip


def test_too_many_values(tmp_path: Path) -> None:
    text = '{"a": [' + "0," * MAX_VALUES + "0]}"
    assert "holds more than 250,000 values" in refused(tmp_path, "json", text)


def test_number_at() -> None:
    document = {"a": {"b": 2, "c": True, "d": "0.5", "e": None}, "f": 0.5}
    assert number_at(document, "a.b", "file") == 2.0 and number_at(document, "f", "file") == 0.5
    for keys, found in (
        ("a.c", "is True"), ("a.d", "is '0.5'"), ("a.e", "is missing"),
        ("a.b.x", "is missing"), ("g", "is missing"), ("a", "is {'b': 2"),
    ):  # fmt: skip
        with pytest.raises(InputError) as caught:
            number_at(document, keys, "file")
        assert str(caught.value).startswith(f"file: {keys} {found}")


def test_latin_1_is_taken_where_that_is_said(tmp_path: Path) -> None:
    path = written(tmp_path, "txt", "Größe\n".encode("latin-1"))
    assert read_text(path, 100, "a table", latin_1=True) == "Größe\n"
    with pytest.raises(InputError, match="is not UTF-8 text"):
        read_text(path, 100, "a table")


def test_what_is_shown_can_be_written() -> None:
    name = os.fsdecode(b"gr\xf6\xdfe\n\x1b[1m.png")
    assert printable(name) == r"gr\udcf6\udcdfe\n\x1b[1m.png"
    assert printable("größe\u3000℃.png") == "größe\u3000℃.png"
    assert shown("x" * 10_000) == "'" + "x" * 75 + " ..."
    assert shown(10**5000) == "a number of thousands of digits"


def xml_written(folder: Path, content: bytes) -> Path:
    path = folder / "a.xml"
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    "head", [b"", b"\xef\xbb\xbf", b'<?xml version="1.0" encoding="latin-1"?>', b"<!-- a -->\n"]
)
def test_text_is_utf_8_whatever_the_file_says(tmp_path: Path, head: bytes) -> None:
    root = read_xml(xml_written(tmp_path, head + '<a b="ü"><c/><c/></a>'.encode()), "a URDF file")
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
        (b"<a>" * (XML_MAX_DEPTH + 1), "is nested more than 100 deep"),
        (b"<a>\xff</a>", "is not UTF-8 text"),
        (b"<a>\0</a>", "has a NUL byte"),
        ("<a/>".encode("utf-16"), "is UTF-16 text"),
        (b" " * (XML_LIMIT_BYTES + 1), "a URDF file may have up to 16 MiB"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, content: bytes, words: str) -> None:
    path = xml_written(tmp_path, content)
    with pytest.raises(InputError, match=words) as error:
        read_xml(path, "a URDF file")
    assert str(path) in str(error.value)


def test_siblings_are_not_depth(tmp_path: Path) -> None:
    path = xml_written(tmp_path, b"<a>" + b"<b><c/></b>" * 1000 + b"</a>")
    assert len(read_xml(path, "a URDF file")) == 1000
