# SPDX-License-Identifier: Apache-2.0
"""What commands print: words as they are, stages as they begin, JSON alone, a picture first."""

from __future__ import annotations

import ast
import io
import json
import os
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import warp as wp
from rich.console import Console
from rich.table import Table

import taccel_lab.cli
from taccel_lab import progress as progress
from taccel_lab.cli.console import be_quiet, notes, results, say_first_look, working
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.processes.start_warp import first_step
from tests.cli.test_app import commands, python
from tests.support.commands import run
from tests.support.variants import variants

SENTENCE = "write thickness_mm under [design], radius_mm under [indenter]; [/] [red] 3/4"
SOURCES = sorted(Path(taccel_lab.cli.__file__).parent.rglob("*.py"))


@pytest.mark.parametrize("console", [results, notes])
def test_brackets_are_printed(
    console: Callable[[], Console], capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("[block]", title="[material]", width=120)
    table.add_row(SENTENCE)
    shown = console()
    shown.print(SENTENCE, soft_wrap=True)
    shown.print(table, soft_wrap=True)
    with working(shown, SENTENCE):  # It would be an error of rich's markup.
        pass
    told = "".join(capsys.readouterr())
    assert told.count(SENTENCE) == 2
    assert "[block]" in told and "[material]" in told


def test_nothing_is_noted_when_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    be_quiet(True)
    notes().print("how far it is")
    results().print("what was found")
    be_quiet(False)
    assert capsys.readouterr() == ("what was found\n", "")


def test_no_command_prints_in_a_way_of_its_own_or_in_markup() -> None:
    """A console of its own would take brackets as markup again, as its turning signs do; what is
    written in markup would be printed as it stands: a colour is a ``Text`` with a style."""
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        own = [words for words in ("Console(", ".status(", "from_markup") if words in text]
        assert not own or path.name == "console.py", (path.name, own)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                colours = r"\[/|\[(bold|dim|italic|red|green|yellow|cyan|blue|magenta)\b"
                assert not re.search(colours, node.value), f"{path.name}:{node.lineno}"


@pytest.mark.parametrize("terminal", [False, True])
def test_a_log_gets_lines_and_a_terminal_bars(
    monkeypatch: pytest.MonkeyPatch, terminal: bool
) -> None:
    monkeypatch.setattr(progress, "BEAT_S", 0.05)
    out = io.StringIO()
    console = Console(file=out, width=100, force_terminal=terminal)
    with progress.stage_progress(console) as stage:
        assert ("reading ...\n" in out.getvalue()) != terminal
        stage("finding boards", 1, 2)
        stage("fitting the lens", 4, 5)
        if terminal:
            time.sleep(0.2)
        while not terminal and "fitting the lens 4/5 (" not in out.getvalue():
            time.sleep(0.01)
    if terminal:
        assert "4/5 (" not in out.getvalue() and "fitting the lens" in out.getvalue()
    with pytest.raises(ValueError, match="x"), progress.stage_progress(console):
        raise ValueError("x")
    assert "progress" not in {thread.name for thread in threading.enumerate()}


@pytest.mark.parametrize("terminal", [False, True])
def test_every_stage_is_said(terminal: bool) -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=80)
    with progress.stage_words(console) as say:
        for words in ("meshing", "meshing", "press [1]"):
            say(words)
            while terminal and words not in out.getvalue():
                time.sleep(0.01)
    assert "meshing" in out.getvalue() and "press [1]" in out.getvalue()
    if terminal:
        assert "0:00:0" in out.getvalue()
    else:
        assert out.getvalue() == "meshing ...\npress [1] ...\n"


def test_the_first_press_of_a_machine_says_what_takes_so_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    assert first_step().startswith("compiling the solver, once on this machine")
    (tmp_path / "wp_taccel_lab.solvers.start_step_617cc52").mkdir()
    assert first_step() == "first step"


CHEAP = {
    "capture check": "CAPTURES",
    "capture devices": "",
    "capture guide": "gelsight_mini",
    "capture import": "CAPTURES OUT --layout plain",
    "doctor": "",
    "export": "PROFILE --to taxim --out OUT",
    "preview": "PROFILE --out OUT --presses --size-px 64",
    "profile report": "PROFILE --out OUT",
    "profile show": "PROFILE",
    "profile validate": "PROFILE",
    "robot list": "",
    "robot show": "panda",
    "sensors list": "",
    "sensors show": "gelsight",
    "study": "--list-presses",
    "task list": "",
}
"""Words behind commands that are done within seconds, or refuse them for a reason of their own."""
NO_JSON = ("bench", "view")


@pytest.mark.thorough(cases=("capture check", "preview"))
@pytest.mark.parametrize("command", sorted(CHEAP))
def test_what_is_printed_is_json(
    command: str, places: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    known = {**places, "OUT": str(tmp_path / "out")}
    words = [known.get(word, word) for word in CHEAP[command].split()]
    code = run(*command.split(), *words, "--json")
    said, noted = capfd.readouterr()
    if code in (0, 1):
        json.loads(said)
    else:
        assert said == "" and noted


@pytest.mark.parametrize("command", [name for name, _ in commands() if name not in NO_JSON])
def test_a_command_that_fails_prints_nothing(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*command.split(), "--json", "--no-such-option", "1") == 2
    said, noted = capfd.readouterr()
    assert said == "" and noted


BESIDE = """
import os, subprocess, sys
from taccel_lab.cli.console import only_json, print_json
with only_json():
    print("a table")
    os.write(1, b"a library in C\\n")
    subprocess.run([sys.executable, "-c", "print('a process of ours')"], check=True)
    print_json({"a": 1})
    print("a banner")
print("afterwards")
"""


def test_whoever_writes_beside_it_is_sent_to_standard_error() -> None:
    done = python(BESIDE)
    assert done.returncode == 0 and done.stdout.endswith("afterwards\n")
    assert json.loads(done.stdout.removesuffix("afterwards\n")) == {"a": 1}
    for words in ("a table", "a library in C", "a process of ours", "a banner"):
        assert words in done.stderr


def test_a_first_look_stays_where_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder that is being written has a hidden name, which is gone with the next line."""
    monkeypatch.setenv("TACCEL_LAB_CACHE", str(tmp_path / "cache"))
    for picture in (b"one", b"another"):
        with atomic_directory(tmp_path / "out") as folder:
            (folder / "scene.png").write_bytes(picture)
            say_first_look(notes(), folder / "scene.png")
        told = capsys.readouterr().err.strip().removeprefix("first look: ")
        assert Path(told).read_bytes() == picture and "/." not in told.removeprefix(str(tmp_path))
    assert len(list((tmp_path / "cache").rglob("*.png"))) == 1


FIRST = """
import sys
from taccel_lab.cli import console

say = console.say_first_look

def look(shown, picture):
    say(shown, picture)
    warp = sys.modules.get("warp")
    modules = warp._src.context.user_modules.values() if warp else ()
    print("LOADED", *(m.name for m in modules if m.execs))
    print("BUILT", *({"build123d", "OCP"} & set(sys.modules)))
    print("SIZE", picture.stat().st_size)
    raise KeyboardInterrupt

console.say_first_look = look
from taccel_lab.cli.app import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "command", variants(["press --depth-mm 0.5"], ["press --depth-mm 0.5", "preview", "design"])
)
def test_a_picture_stands_before_anything_is_compiled_or_built(
    command: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In a fresh process, which is interrupted there: nothing is left then."""
    words = [*command.split(), "gelsight_mini", "--out", tmp_path / "deep" / "out"]
    cache = str(tmp_path_factory.mktemp("cache"))
    run = python(FIRST, *words, env={**os.environ, "TACCEL_LAB_CACHE": cache})
    assert run.returncode == 130, run.stderr
    lines = [line for line in run.stdout.splitlines() if line.split()[0].isupper()]
    assert lines[:2] == ["LOADED", "BUILT"]
    assert int(lines[2].split()[1]) > 20_000
    assert list(tmp_path.iterdir()) == []
    # The picture that was told of is still there.
    told = next(line for line in run.stderr.splitlines() if line.startswith("first look: "))
    assert Path(told.removeprefix("first look: ")).stat().st_size == int(lines[2].split()[1])
