# SPDX-License-Identifier: Apache-2.0
"""Whatever a message quotes from a damaged file, a person can read it."""

from __future__ import annotations

import io

import pytest
from rich.table import Table
from rich.text import Text

from taccel_lab.errors import InputError, InputWarning, naming
from taccel_lab.plain_console import PlainConsole
from taccel_lab.printable import printable, readable


def test_control_characters_and_bytes_that_are_no_text_are_escaped() -> None:
    assert printable("a\x00b\x1b[2J\udcff\x85\n") == "a\\x00b\\x1b[2J\\udcff\\x85\\n"
    assert readable("µm: ü 界\nsecond\tline") == "µm: ü 界\nsecond\\tline"
    assert readable(readable("a\x00b")) == readable("a\x00b")


def test_endless_words_are_cut_in_the_middle_and_paths_are_not() -> None:
    message = readable(f"f.toml names {'x' * 100_000}, which is no press")
    assert message.startswith("f.toml names xxx") and message.endswith(", which is no press")
    assert "(100,001 letters)" in message and len(message) < 200
    path = "/" + "/".join(["folder"] * 40)
    assert readable(f"{path} is empty") == f"{path} is empty"


def test_input_errors_are_readable_and_name_their_file() -> None:
    assert str(InputError("a\x00b")) == str(InputWarning("a\x00b")) == "a\\x00b"
    with pytest.raises(InputError, match=r"^s\.toml: no metric 'x'$"), naming("s.toml"):
        raise InputError("no metric 'x'")
    with pytest.raises(InputError, match=r"^s\.toml is empty$"), naming("s.toml"):
        raise InputError("s.toml is empty")
    with pytest.raises(KeyError), naming("s.toml"):
        raise KeyError("x")


def test_a_console_shows_what_others_wrote_and_does_none_of_it() -> None:
    """Neither a terminal's escapes nor markup, in whatever is printed."""
    name = "a\x1b]0;x\x07b\x1b[31m[red]"
    table = Table("file", title=name)
    table.add_row(name)
    file = io.StringIO()
    console = PlainConsole(file=file, width=200)
    console.print(name, Text(name), table)
    with console.status(Text(name)):
        console.print("µm\nsecond line")
    said = file.getvalue()
    assert "\x1b" not in said and "\x07" not in said
    assert said.count("\\x1b[31m[red]") >= 4 and "µm\nsecond line" in said
