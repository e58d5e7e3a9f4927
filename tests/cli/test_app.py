# SPDX-License-Identifier: Apache-2.0
"""The command line as a whole: words, help and its speed, streams."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import json
import os
import re
import resource
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cli import app
from taccel_lab.cli.design import Design
from taccel_lab.cli.press import PressCommand
from taccel_lab.cli.words import common_words
from taccel_lab.version import __version__
from tests.cli.conftest import Cli


def started(*command: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """A process of its own, with what it printed. Ctrl-C reaches it, also where these tests run in
    the background of a shell, which ignores it for all that they start."""
    options.setdefault("preexec_fn", lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    root = Path(__file__).parents[2]
    return subprocess.run([*map(str, command)], capture_output=True, text=True, cwd=root, **options)


def python(code: str, *words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    return started(sys.executable, "-c", textwrap.dedent(code), *words, **options)


@pytest.mark.thorough
def test_file_names_that_are_no_text_can_be_printed(tmp_path: Path) -> None:
    """By a command that reads a profile: it starts without Warp, in a quarter of the time."""
    name = f"{tmp_path}/m\udce4rz"
    os.mkdir(name)
    program = """
        import sys
        from taccel_lab.cli.app import main
        code = main()
        sys.exit(code if 'warp' not in sys.modules else 'Warp is loaded')
    """
    for options in ([], ["--json"]):
        environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
        done = python(program, "profile", "validate", name, *options, env=environment)
        assert done.returncode == 2 and "Traceback" not in done.stderr
        assert r"/m\udce4rz" in done.stdout + done.stderr


@pytest.mark.parametrize("words", ["profile show", "profile show x more"])
def test_usage_errors_exit_with_2(cli: Cli, words: str) -> None:
    cli(words, code=2)


@pytest.mark.parametrize("more", [[], ["--help"], ["--out", "x"]])
@pytest.mark.parametrize(
    ("words", "meant", "has"),
    [
        ("pres", "press", "taccel-lab --help lists all"),
        ("capture chek", "check", "taccel-lab capture --help lists all"),
        ("zzz", None, "taccel-lab --help lists all"),
    ],
)
def test_a_command_that_is_not_there(
    cli: Cli, words: str, meant: str | None, has: str, more: list[str]
) -> None:
    told = cli(words, *more, code=2).err
    assert f"{words.split()[-1]!r}" in told and has in told
    assert ("did you mean" in told) == (meant is not None)
    assert meant is None or f"did you mean {meant}?" in told


def test_help_stands_where_no_command_is_named_and_the_version_is_said(cli: Cli) -> None:
    for words in ("", "capture", "calibrate"):
        assert f"usage: taccel-lab {words}".strip() in cli(words).out
    assert cli("--version").out == f"taccel-lab {__version__}\n"


def test_auto_is_a_device_of_this_machine() -> None:
    known = {"cpu", "cuda:0"}
    for words in (["press", "--device", "auto"], ["press", "--device=auto"]):
        found, quiet = common_words(words)
        assert not quiet and set(" ".join(found).replace("=", " ").split()) & known
    assert common_words(["capture", "auto", "--quiet"]) == (["capture", "auto"], True)


QUIET = """
    import sys
    from taccel_lab.cli import app

    class Command:
        def run(self):
            from taccel_lab.cli.console import notes, print_json
            from taccel_lab.errors import InputError
            from taccel_lab.processes.start_warp import start_warp

            start_warp()
            notes().print("how far it is")
            print_json({"a": 1})
            raise InputError("no_such")

    parse = app.parse
    app.parse = lambda arguments: parse(arguments) and Command()
    sys.exit(app.main(["sensors", "list", "--quiet"]))
"""


@pytest.mark.thorough
def test_quiet_leaves_results_and_errors() -> None:
    """In a process of its own: Warp's library writes to the process' standard error itself."""
    done = python(QUIET)
    assert json.loads(done.stdout) == {"a": 1}
    assert (done.returncode, done.stderr) == (2, "error: no_such\n")


def commands() -> Iterator[tuple[str, type]]:
    """Words and class of every command."""
    for name, found in app.command_tree().items():
        inner = found.commands if isinstance(found, app.Group) else {"": found}
        yield from ((f"{name} {word}".strip(), command) for word, command in inner.items())


SWITCHED_ON = {"calibrate color": {"cache", "table"}}
"""Booleans that are on by default. Their help stands beside ``--x`` and ``--no-x`` at once."""


@pytest.mark.parametrize("command", [words for words, _ in commands()])
def test_help_of_every_command_and_its_switches(
    cli: Cli, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    shown = cli(command, "--help").out
    assert f"usage: taccel-lab {command}" in shown
    text = " ".join(shown.replace("│", " ").split())
    found = re.findall(r"--no-([a-z-]+) ([A-Z][^()]*?)\(default: (True|False)\)", text)
    assert {name for name, _, on in found if on == "True"} >= SWITCHED_ON.get(command, set())
    for name, words, on in found:
        told = words.startswith("Whether ") or f"--no-{name} " in words
        assert on == "False" or told, (name, words)


@pytest.mark.thorough
def test_every_option_is_explained_and_every_command_prints_json() -> None:
    found = dict(commands())
    assert len(found) > 40
    for words, command in found.items():
        fields = {field.name for field in dataclasses.fields(command)}
        assert "json" in fields or words in ("bench", "view"), words
        for base in filter(dataclasses.is_dataclass, command.__mro__):
            assert base.__doc__, base
            if base.__module__ == "types":
                continue  # It is made of others, and has their fields.
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body
            for field, after in itertools.pairwise(body):
                if isinstance(field, ast.AnnAssign) and "ClassVar" not in ast.unparse(field):
                    told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                    assert told, f"{base.__name__}.{ast.unparse(field.target)} has no docstring"


HELP = """
    import sys
    from taccel_lab.cli import app
    try:
        app.main(['--help'])
    except SystemExit:
        pass
    heavy = {'warp', 'torch', 'build123d', 'OCP', 'pyvista', 'cv2', 'scipy', 'matplotlib'}
    sys.exit(','.join(sorted(heavy & set(sys.modules))) or 0)
"""


@pytest.mark.thorough
def test_help_is_fast_and_light() -> None:
    """By the work of finished processes: what others do on this machine does not count."""

    def worked_s() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    took = []
    while not took or (took[-1] >= 1.0 and len(took) < 3):
        start = worked_s()
        done = python(HELP)
        took.append(worked_s() - start)
        assert done.returncode == 0, f"help imports {done.stderr}"
        assert "calibrate" in done.stdout
    assert min(took) < 1.0


FROZEN = """
    import atexit, gc, sys
    from taccel_lab.cli.app import main
    # Called last: what is registered later is called before.
    atexit.register(lambda: print(gc.get_freeze_count() > 10_000))
    sys.argv = ["taccel-lab", "--version"]
    main()
"""


def test_no_garbage_is_looked_for_as_the_process_ends() -> None:
    assert python(FROZEN).stdout.splitlines()[-1] == "True"


@pytest.mark.thorough
def test_a_reader_that_is_gone_ends_a_table_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "taccel_lab.cli.app", "sensors", "list"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.thorough(cases=("press --help >&-", "sensors list --json >&-"))
@pytest.mark.parametrize("words", ["sensors list --json >&-", "press --help >&-", "zzz 2>&-"])
def test_closed_streams_change_no_exit_code(words: str) -> None:
    done = started("bash", "-c", f"{sys.executable} -m taccel_lab.cli.app {words}")
    assert (done.returncode, done.stdout, done.stderr) == (2 if "zzz" in words else 0, "", "")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            "press --indentor ball digit",
            "press has no option --indentor (did you mean --indenter?)",
        ),
        ("press --hlp", "press has no option --hlp (did you mean --help?)"),
        ("press -out x digit", "press has no option -out (did you mean --out?)"),
        ("capture record --scales=x", "capture record has no option --scales (did you mean --sc"),
        ("design --prt 3", "design has no option --prt (did you mean --port?)"),
        (
            "dataset x.toml --limitt 3",
            "dataset make has no option --limitt (did you mean --limit?)",
        ),
        ("preview -dash.png", "preview has no option -dash.png; write a file or folder of that"),
        ("view --zzz", "view has no option --zzz\n"),
    ],
)
def test_an_option_that_is_not_there_is_named_whatever_else_is_missing(
    cli: Cli, words: str, told: str
) -> None:
    done = cli(words, code=2)
    assert f"error: taccel-lab {told}" in done.err and done.out == ""
    assert "--help lists the options" in done.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--depth-mm 0,5", "--depth-mm: '0,5' is not a number; decimals have a point: 0.5"),
        ("--force-n 2N", "--force-n: '2N' is not a number; write it without a unit: 2"),
        ("--twist-deg nan", "--twist-deg: 'nan' is not allowed, only finite numbers are"),
        ("--at-mm 1 -inf", "--at-mm: '-inf' is not allowed, only finite numbers are"),
        ("--shear-mm 0.1 x", "--shear-mm: 'x' is not a number"),
        ("--texture=", "--texture: an empty name is not allowed; this folder is written ."),
        ("--element None", "--element: 'None' is not allowed; allowed: linear, quadratic"),
        ("--element Quad", "'Quad' is not allowed (did you mean quadratic?)"),
    ],
)
def test_a_value_that_is_not_allowed_is_told_in_words(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, words: str, told: str
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert told in cli(f"press digit --out x {words}", code=2).err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (
            "export gelsight_mini --out x --to taxin",
            "--to: 'taxin' is not allowed (did you mean taxim?)",
        ),
        (
            "dataset export lerobo x --out x",
            "FORMAT: 'lerobo' is not allowed (did you mean lerobot?)",
        ),
        (
            "design digit --out x --parts pad moud",
            "--parts: 'moud' is not allowed (did you mean mould?)",
        ),
    ],
)
def test_a_choice_that_is_not_there_names_the_nearest(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, words: str, meant: str
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    told = cli(words, code=2).err
    assert meant in told and "; allowed: " in told


def test_choices_of_several_words_are_read_and_completed(cli: Cli) -> None:
    command = app.parse("design digit --out x --parts pad mould".split())
    assert isinstance(command, Design) and command.parts == ("pad", "mould")
    assert "isaac-lab" in cli("--tyro-print-completion bash").out


def test_numbers_are_read() -> None:
    words = "press digit --out x --depth_mm=-0.5 --at-mm -1 2e-1 --tolerance 1"
    command = app.parse(words.split())
    assert isinstance(command, PressCommand)
    assert (command.depth_mm, command.at_mm, command.force_n) == (-0.5, (-1.0, 0.2), None)
    assert isinstance(command.tolerance, float)
