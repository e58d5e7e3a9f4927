# SPDX-License-Identifier: Apache-2.0
"""Text, tables and seeds of others are read or refused in a sentence."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.depth.options import DepthOptions
from taccel_lab.calibration.normals.options import InverseFitOptions
from taccel_lab.errors import InputError
from taccel_lab.files import table_file
from taccel_lab.files.documents import (
    JSON_LIMIT_BYTES,
    MAX_DEPTH,
    MAX_VALUES,
    TOML_LIMIT_BYTES,
    YAML_LIMIT_BYTES,
    number_at,
    read_json,
    read_toml,
    read_yaml,
)
from taccel_lab.files.regular_file import read_text, shown
from taccel_lab.files.strict_model import Flag, Number, StrictModel, Whole
from taccel_lab.files.table_file import MAX_LINE_CHARACTERS, number, read_table
from taccel_lab.files.xml_file import MAX_DEPTH as XML_MAX_DEPTH
from taccel_lab.files.xml_file import XML_LIMIT_BYTES, read_xml
from taccel_lab.guards import MOST_SEED, require_seed
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.printable import printable

Read = Callable[[Path], dict[str, Any]]
READERS: dict[str, Read] = {"toml": read_toml, "json": read_json, "yaml": read_yaml}
LIMITS = {"toml": TOML_LIMIT_BYTES, "json": JSON_LIMIT_BYTES, "yaml": YAML_LIMIT_BYTES}


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


@pytest.mark.thorough(cases=("yaml-text8",))
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


DIGITS = {"toml": "a = {}", "json": '{{"a": {}}}', "yaml": "a: {}"}


@pytest.mark.parametrize(
    ("kind", "text", "words"),
    [
        *(
            (kind, text.format("9" * digits), words)
            for kind, text in DIGITS.items()
            for digits, words in (
                (19, ": a is a whole number of 64 bits; 63 are allowed"),
                (22, "64 bits are" if kind == "json" else "of 74 bits; 63 are allowed"),
                (5000, "digits"),
            )
        ),
        # Python reads any number of those digits, and then fails to write the number.
        ("toml", "a = 0x" + "f" * 900, ": a is a whole number of 3600 bits; 63 are allowed"),
        ("toml", "\na = 0x" + "f" * 20_000, "line 2 has a number of 1,000 digits"),
        ("toml", "[b]\na = [1, nan]", ": b.a.1 is nan"),
        ("toml", "[b]\na = [1, -inf]", ": b.a.1 is -inf"),
        ("toml", "[b]\na = [1, 1e999]", "a finite number is needed"),
        ("json", '{"b": {"a": [1, 1e999]}}', ": b.a.1 is inf"),
        ("yaml", "b:\n  a: [1, 1e999]", ": b.a.1 is inf"),
        ("toml", "a = 1\na = 2", "is not valid TOML: Cannot overwrite a value"),
        ("toml", "a = 2026-99-99", "is not valid TOML"),
        ("json", '{"a": 1, "b": 2, "a": 3}', "is not valid JSON: the key 'a' stands twice"),
        ("json", '{"a": NaN}', "is not valid JSON: NaN is no number of JSON"),
        ("json", '{"a": "\\ud800"}', "holds half a character"),
        ("json", '{"\\udfff": 1}', "holds half a character"),
        ("json", "[1, 2]", "holds [1, 2]; a table {...} of keys is needed"),
        ("json", '{"a"', "is not valid JSON"),
        ("json", '{"a": [' + "0," * MAX_VALUES + "0]}", "holds more than 250,000 values"),
        ("yaml", "a: &a [1, 2]\nb: [*a, *a]", "as YAML: anchors and aliases are not read"),
        ("yaml", "b: *a", "anchors and aliases are not read"),
        ("yaml", "a: !!python/tuple [1]", "are not read"),
        ("yaml", "a: !!binary aGk=", "tags ('tag:yaml.org,2002:binary') are not read"),
        ("yaml", "a: 1\nb: 2\na: 3", "the key 'a' stands twice"),
        ("yaml", "[1]: 2", "a list or table as a key is not read"),
        ("yaml", "a: 1\n---\nb: 2", "expected a single document"),
        ("yaml", "just words", "holds 'just words'; a table {...} of keys is needed"),
        ("yaml", 'a: "\\ud800"', "holds half a character"),
        ("yaml", "a: b: c", "mapping values are not allowed"),
    ],
)
def test_other_faults(tmp_path: Path, kind: str, text: str, words: str) -> None:
    assert words in refused(tmp_path, kind, text)


def test_words_that_yaml_1_1_makes_something_else_of(tmp_path: Path) -> None:
    text = "a: yes\nb: 1:30\nc: 1_000\nd: 2026-11-22\ne: 010\n2: .inf\n<<: x\n"
    assert read_yaml(written(tmp_path, "yaml", text)) == {
        "a": "yes", "b": "1:30", "c": "1_000", "d": "2026-11-22", "e": 10, "2": ".inf", "<<": "x",
    }  # fmt: skip


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


@pytest.mark.parametrize(
    "head", [b"", b"\xef\xbb\xbf", b'<?xml version="1.0" encoding="latin-1"?>', b"<!-- a -->\n"]
)
def test_text_is_utf_8_whatever_the_file_says(tmp_path: Path, head: bytes) -> None:
    path = written(tmp_path, "xml", head + '<a b="ü"><c/><c/></a>'.encode())
    root = read_xml(path, "a URDF file")
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
    path = written(tmp_path, "xml", content)
    with pytest.raises(InputError, match=words) as error:
        read_xml(path, "a URDF file")
    assert str(path) in str(error.value)


def test_siblings_are_not_depth(tmp_path: Path) -> None:
    path = written(tmp_path, "xml", "<a>" + "<b><c/></b>" * 1000 + "</a>")
    assert len(read_xml(path, "a URDF file")) == 1000


def numbers(path: Path) -> list[list[float]]:
    table = read_table(path)
    return [[row.number(k) for k in range(len(table.header))] for row in table.rows()]


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1.5,2\n-3,4e1\n",
        "a,b\r\n1.5,2\r\n-3,4e1",
        "a,b\r1.5,2\r-3,4e1\r",
        "\ufeffa,b\n1.5,2\n-3,4e1\n",
        "# by hand\n\n a , b\n# and more\n 1.5, 2 \n\n-3,4e1\n",
        '"a","b"\n"1.5","2"\n-3,4e1\n',
        "a;b\n1,5;2\n-3;4e1\n",
        "a\tb\n1,5\t2\n-3\t4e1\n",
    ],
)
def test_dialects(tmp_path: Path, text: str) -> None:
    path = written(tmp_path, "csv", text)
    assert read_table(path).header == ("a", "b")
    assert numbers(path) == [[1.5, 2.0], [-3.0, 40.0]]


def test_cells_in_quotes_and_bytes_that_are_no_utf_8(tmp_path: Path) -> None:
    table = read_table(
        written(tmp_path, "csv", b'file,note\n"a,b.png","say ""hi"""\nf\xfcr.png,\x85\n')
    )
    rows = [[row.text(0), row.text(1)] for row in table.rows()]
    assert rows == [["a,b.png", 'say "hi"'], ["für.png", ""]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty; a table begins with the names"),
        ("# only\n\n", "is empty"),
        ("a,b,a\n1,2,3\n", "has the column 'a' twice; which one counts?"),
        ("a,b\n1,2\n3\n", "line 3 has 1 cells, the header 2"),
        ("a,b\n\n# c\n1,2,3\n", "line 4 has 3 cells, the header 2; beside decimal commas"),
        ('a,b\n1,"2\n3,4\n', "line 2: a quote is not closed"),
        ('a,b\n1,"2"x\n', "line 2: ',' expected after"),
        ('"a,b\n1,2\n', "line 1: a quote is not closed"),
        ("a,b\n1,x\n", "line 2: column b: 'x' is not a finite number"),
        ("a,b\n1,\n", "line 2: column b: '' is not a finite number"),
        ("a,b\n1,1_0\n", "line 2: column b: '1_0' is not a finite number"),
        ("a,b\n1," + "2" * MAX_LINE_CHARACTERS + "\n", "line 2 has 131,074 characters; a row may"),
        ("a,b\n1,2\n\0\n", "has a NUL byte in line 3"),
    ],
)
def test_faults_name_file_and_line(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, "csv", text)
    with pytest.raises(InputError) as caught:
        numbers(path)
    assert str(caught.value).startswith(str(path)) and words in str(caught.value)


def test_too_many_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_file, "MAX_LINES", 4)
    assert len(numbers(written(tmp_path, "csv", "a,b\n" + "1,2\n" * 3))) == 3
    with pytest.raises(InputError, match="has 5 lines; up to 4 are allowed"):
        numbers(written(tmp_path, "csv", "a,b\n" + "1,2\n" * 4))


def test_columns_by_any_of_their_names(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, "csv", ",Name,X,x,v\n0,a,1,2,3\n"))
    assert table.column("file", "name") == 1 and table.column("w") is None
    assert table.require_column("v") == 4
    with pytest.raises(InputError, match="has the columns X and x; one is needed"):
        table.column("u", "x")
    with pytest.raises(InputError, match=r"lacks a column u or w \(found , Name, X, x, v\)"):
        table.require_column("u", "w")


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_is_read_back(value: float) -> None:
    assert number(repr(value)) == value and number(f" {value:.17g}\t") == value


@pytest.mark.parametrize(
    "text",
    ["", " ", "0.4_5", "1_0", "nan", "inf", "-Infinity", "1e999", "0x10", "1,5", "١٢", "１２", "²",
     "1 2", "1e", ".", "--1", "+-1", "1d3", "true", "\u00a01", "1\n", "0" * 65],
)  # fmt: skip
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(ValueError, match="is not a"):
        number(text)


class Ball(StrictModel):
    radius_mm: Number = Field(gt=0)
    count: Whole = 1
    hollow: Flag = False


class Box(StrictModel):
    balls: list[Ball] = Field(default_factory=list)


def said_of_box(folder: Path, text: str) -> str:
    """What is said of a file that is no box."""
    with pytest.raises(InputError) as caught:
        Box.read(written(folder, "toml", text))
    return str(caught.value)


def test_numbers_of_python_and_numpy() -> None:
    ball = Ball(radius_mm=2, count=np.int64(3))  # type: ignore[arg-type]
    assert ball == Ball(radius_mm=2.0, count=3)
    assert type(ball.radius_mm) is float and type(ball.count) is int


@pytest.mark.parametrize(
    "entry",
    ['radius_mm = "2"', "radius_mm = true", "radius_mm = 2\ncount = 3.0", "radius_mm = 2026-01-01",
     "radius_mm = 2\ncount = true", "radius_mm = 2\nhollow = 1", 'radius_mm = 2\nhollow = "no"'],
)  # fmt: skip
def test_nothing_is_taken_for_something_else(tmp_path: Path, entry: str) -> None:
    said = said_of_box(tmp_path, f"[[balls]]\n{entry}\n")
    assert re.search(r"file\.toml: balls\.0\.\w+: input should be a valid", said)


@pytest.mark.parametrize("key", ["self", "model_config", "__class__", "__init__", "cls", '""'])
def test_keys_that_python_has_other_uses_for(tmp_path: Path, key: str) -> None:
    said = said_of_box(tmp_path, f"{key} = 1\n")
    assert re.search(r"file\.toml: .*: unknown key.*; allowed: balls", said)


def test_what_is_allowed_in_a_kind_of_table_is_said_once_and_long_lists_are_cut(
    tmp_path: Path,
) -> None:
    """A recipe of thirty sets with an unknown key each took 4,800 letters."""
    entry = "[[balls]]\nradius_mm = 2\nradios_mm = 2\n"
    said = said_of_box(tmp_path, entry)
    assert said.endswith("unknown key (did you mean radius_mm?); allowed: radius_mm, count, hollow")
    said = said_of_box(tmp_path, 30 * entry)
    assert said.count("unknown key") == 20 and said.count("allowed: radius_mm, count") == 1
    said = said_of_box(tmp_path, f"balls = ['{'x' * 5000}',{'1,' * 9999}]")
    assert "and 9980 more faults" in said and len(said) < 21 * 300


@pytest.mark.parametrize("seed", [-1, 10**20])
@pytest.mark.parametrize(
    "options", [ColorFitOptions, InverseFitOptions, DepthOptions, ForceOptions]
)
def test_options_refuse_it(options: Callable[..., object], seed: int) -> None:
    with pytest.raises(InputError, match=rf"seed must lie in 0\.\.{MOST_SEED}, got {seed}"):
        options(seed=seed)


def test_the_largest_seed_is_taken_and_synthetic_presses_have_an_end() -> None:
    torch = pytest.importorskip("torch")
    require_seed(MOST_SEED)
    np.random.default_rng(MOST_SEED)
    torch.Generator().manual_seed(MOST_SEED)
    with pytest.raises(InputError, match=r"synthetic_presses must lie in \[0, 10000\], got -1"):
        InverseFitOptions(synthetic_presses=-1)
