# SPDX-License-Identifier: Apache-2.0
"""Tables of spreadsheets and scripts, models of files: taken as what is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from taccel_lab.errors import InputError
from taccel_lab.files import table_file
from taccel_lab.files.cell_number import number
from taccel_lab.files.strict_model import Flag, Number, StrictModel, Whole
from taccel_lab.files.table_file import MAX_LINE_CHARACTERS, read_table


def written(folder: Path, content: str | bytes) -> Path:
    path = folder / "table.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


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
    path = written(tmp_path, text)
    assert read_table(path).header == ("a", "b")
    assert numbers(path) == [[1.5, 2.0], [-3.0, 40.0]]


def test_cells_in_quotes_and_bytes_that_are_no_utf_8(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, b'file,note\n"a,b.png","say ""hi"""\nf\xfcr.png,\x85\n'))
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
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        numbers(path)
    assert str(caught.value).startswith(str(path)) and words in str(caught.value)


def test_too_many_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_file, "MAX_LINES", 4)
    assert len(numbers(written(tmp_path, "a,b\n" + "1,2\n" * 3))) == 3
    with pytest.raises(InputError, match="more than 4 lines"):
        numbers(written(tmp_path, "a,b\n" + "1,2\n" * 4))


def test_columns_by_any_of_their_names(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, ",Name,X,x,v\n0,a,1,2,3\n"))
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
    path = tmp_path / "box.toml"
    path.write_text(f"[[balls]]\n{entry}\n")
    with pytest.raises(InputError, match=r"box\.toml: balls\.0\.\w+: input should be a valid"):
        Box.read(path)


@pytest.mark.parametrize("key", ["self", "model_config", "__class__", "__init__", "cls", '""'])
def test_keys_that_python_has_other_uses_for(tmp_path: Path, key: str) -> None:
    path = tmp_path / "box.toml"
    path.write_text(f"{key} = 1\n")
    with pytest.raises(InputError, match=r"box\.toml: .*: unknown key; allowed: balls"):
        Box.read(path)


def test_an_unknown_key_of_an_inner_table_says_what_is_allowed_there(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text("[[balls]]\nradius_mm = 2\nradios_mm = 2\n")
    with pytest.raises(
        InputError, match=r"balls\.0\.radios_mm: unknown key; allowed: radius_mm, count, hollow$"
    ):
        Box.read(path)


def test_long_lists_of_faults_are_cut(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text("balls = [" + "'" + "x" * 5000 + "'," + "1," * 9999 + "]")
    with pytest.raises(InputError, match="and 9980 more faults") as caught:
        Box.read(path)
    assert len(str(caught.value)) < 21 * 300
