# SPDX-License-Identifier: Apache-2.0
"""The command line as a whole: exit codes, messages, speed of help."""

from __future__ import annotations

import ast
import dataclasses
import itertools
import json
import os
import re
import resource
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.cli.press import Press
from taccel_lab.cli.words import common_words
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.output_folder import atomic_directory
from taccel_lab.version import __version__

ROOT = Path(__file__).parents[2]


class Raises:
    """A command that ends with the given exception."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error

    def run(self) -> None:
        if self.error is not None:
            raise self.error


def caused(error: Exception, cause: BaseException) -> Exception:
    """What a library makes of an interruption while it loads."""
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (None, 0, ""),
        (InputError("frame 3 is empty"), 2, "error: frame 3 is empty"),
        (SimulationError("no descent in step 4"), 3, "simulation failed: no descent in step 4"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (caused(ImportError("initialization failed"), KeyboardInterrupt()), 130, "interrupted"),
        (caused(InputError("not installed"), KeyboardInterrupt()), 130, "interrupted"),
        (caused(RuntimeError("__set_name__"), app._Terminated()), 143, "asked to end"),
        (PermissionError(13, "Permission denied", "/out"), 2, "error: /out: Permission denied"),
        (OSError(28, "No space left on device"), 2, "error: No space left on device"),
        (OSError(30, "Read-only file system", b"/out"), 2, "error: /out: Read-only file system"),
    ],
)
def test_exit_codes(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException | None,
    code: int,
    words: str,
) -> None:
    monkeypatch.setattr(app, "parse", lambda arguments: Raises(error))
    assert app.main([]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
    assert "Traceback" not in captured.err


def test_file_names_that_are_no_text_can_be_printed(tmp_path: Path) -> None:
    name = os.fsencode(tmp_path) + b"/m\xe4rz"
    os.mkdir(name)
    program = "import sys; from taccel_lab.cli.app import main; sys.exit(main())"
    for options in ([], ["--json"]):
        command = [sys.executable, "-c", program, "profile", "validate", name, *options]
        environment = {**os.environ, "PYTHONIOENCODING": "utf-8"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 2 and "Traceback" not in done.stderr
        assert r"/m\udce4rz" in done.stdout + done.stderr


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError("image file is truncated")])
def test_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(app, "parse", lambda arguments: Raises(error))
    with pytest.raises(type(error)):
        app.main([])


@pytest.mark.parametrize("arguments", [["profile", "show"], ["profile", "show", "x", "more"]])
def test_usage_errors_exit_with_2(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        app.main(arguments)
    assert caught.value.code == 2


@pytest.mark.parametrize("more", [[], ["--help"], ["--out", "x"]])
@pytest.mark.parametrize(
    ("words", "meant", "has"),
    [
        (["pres"], "taccel-lab press", "taccel-lab has: demo, design"),
        (["capture", "chek"], "taccel-lab capture check", "taccel-lab capture has: check"),
        (["zzz"], None, "taccel-lab has: demo, design"),
    ],
)
def test_a_command_that_is_not_there(
    capsys: pytest.CaptureFixture[str], words: list[str], meant: str | None, has: str, more: list
) -> None:
    assert app.main([*words, *more]) == 2
    told = capsys.readouterr().err
    assert f"there is no command {words[-1]!r}" in told and has in told
    assert ("did you mean" in told) == (meant is not None)
    assert meant is None or f"did you mean {meant}?" in told


@pytest.mark.parametrize("words", [[], ["capture"], ["calibrate"]])
def test_without_a_command_there_is_help(
    capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        app.main(words)
    assert caught.value.code == 0
    assert " ".join(["usage: taccel-lab", *words]) in capsys.readouterr().out


def test_the_version_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        app.main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"taccel-lab {__version__}\n"


def test_auto_is_a_device_of_this_machine() -> None:
    known = {"cpu", "cuda:0"}
    for words in (["press", "--device", "auto"], ["press", "--device=auto"]):
        found, quiet = common_words(words)
        assert not quiet and set(" ".join(found).replace("=", " ").split()) & known
    assert common_words(["capture", "auto", "--quiet"]) == (["capture", "auto"], True)


def test_quiet_leaves_results_and_errors(tmp_path: Path) -> None:
    """In a process of its own: Warp's library writes to the process' standard error itself."""

    def told(*words: str) -> tuple[str, str]:
        command = [sys.executable, "-m", "taccel_lab.cli.app", "design", "gelsight_mini", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        return done.stdout, done.stderr

    out = ["--out", str(tmp_path / "out"), "--parts", "pad"]
    said, noted = told(*out, "--quiet", "--json")
    assert noted == ""
    assert json.loads(said)["quality"]["node_count"] > 1000
    said, noted = told(*out, "--quiet", "--set", "no_such=1")
    assert said == "" and "no_such" in noted
    assert "Warp" not in noted and "Module" not in noted


def test_every_command_prints_json() -> None:
    for name, found in app.command_tree().items():
        inner = found.commands if isinstance(found, app.Group) else {"": found}
        for word, command in inner.items():
            names = {field.name for field in dataclasses.fields(command)}  # type: ignore[arg-type]
            assert "json" in names or name in ("bench", "view"), f"{name} {word}"


COMMANDS = (
    "demo",
    "design",
    "press",
    "calibrate color",
    "export",
    "profile show",
    "profile validate",
    "sensors list",
    "sensors show",
    "robot list",
    "robot show",
    "task list",
    "task run",
    "task record",
    "doctor",
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        app.main([*command.split(), "--help"])
    assert caught.value.code == 0
    assert f"usage: taccel-lab {command}" in capsys.readouterr().out


SWITCHED_ON = {
    "calibrate color": ("register", "cache", "table"),
}
"""Booleans that are on by default. Their help stands beside ``--x`` and ``--no-x`` at once."""


@pytest.mark.parametrize("command", sorted({*COMMANDS, *SWITCHED_ON, "calibrate all", "study"}))
def test_help_of_switches_reads_the_right_way_round(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        app.main([*command.split(), "--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    found = re.findall(r"--no-([a-z-]+) ([A-Z][^()]*?)\(default: (True|False)\)", text)
    on = {name for name, _, default in found if default == "True"}
    assert on == set(SWITCHED_ON.get(command, ()))
    for name, words, default in found:
        assert default == "False" or words.startswith("Whether "), (name, words)


def command_classes() -> Iterator[ast.ClassDef]:
    for path in sorted((ROOT / "taccel_lab" / "cli").rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.name != "Command":
                runs = any(isinstance(m, ast.FunctionDef) and m.name == "run" for m in node.body)
                if runs or "BlockCommand" in map(ast.unparse, node.bases):
                    yield node


def test_every_option_is_explained() -> None:
    names = set()
    for command in command_classes():
        names.add(command.name)
        assert ast.get_docstring(command), command.name
        for field, after in itertools.pairwise(command.body):
            if isinstance(field, ast.AnnAssign):
                explained = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                assert explained, f"{command.name}.{ast.unparse(field.target)} has no docstring"
    assert names >= {"Demo", "Design", "Press", "CalibrateColor", "ProfileShow", "Doctor"}


def _seconds_of_children() -> float:
    """That finished processes worked; what others do on this machine does not count [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_help_is_fast_and_light() -> None:
    code = (
        "import sys\n"
        "from taccel_lab.cli import app\n"
        "try:\n"
        "    app.main(['--help'])\n"
        "except SystemExit:\n"
        "    pass\n"
        "heavy = {'warp', 'torch', 'build123d', 'OCP', 'pyvista', 'cv2', 'scipy', 'matplotlib'}\n"
        "sys.exit(','.join(sorted(heavy & set(sys.modules))) or 0)\n"
    )
    best = float("inf")
    for _ in range(3):
        start = _seconds_of_children()
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            capture_output=True,
            text=True,
            encoding="utf-8",
            check=False,
        )
        best = min(best, _seconds_of_children() - start)
        assert done.returncode == 0, f"help imports {done.stderr}"
        assert "calibrate" in done.stdout
    assert best < 1.0, f"help took {best:.2f} s"


TERMINATED = """
    import os, signal, sys
    from pathlib import Path
    from taccel_lab.cli import app
    from taccel_lab.output_folder import atomic_directory

    class Command:
        def run(self):
            with atomic_directory(sys.argv[1]) as folder:
                (folder / "half.txt").write_text("half")
                os.kill(os.getpid(), signal.SIGTERM)
                (folder / "more.txt").write_text("more")

    app.parse = lambda arguments: Command()
    sys.exit(app.main([]))
"""


@pytest.mark.parametrize("earlier", [False, True])
def test_asked_to_end_it_clears_away_what_is_unfinished(tmp_path: Path, earlier: bool) -> None:
    out = tmp_path / "out"
    if earlier:
        with atomic_directory(out) as folder:
            (folder / "a.txt").write_text("old")
    before = sorted(path.name for path in tmp_path.rglob("*"))
    command = [sys.executable, "-c", textwrap.dedent(TERMINATED), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        143,
        "asked to end; what was half written was removed\n",
    )
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


LOADS_THE_KERNEL = """
    import signal, sys
    from taccel_lab.cli import app

    class Command:
        def run(self):
            signal.signal(signal.SIGINT, signal.default_int_handler)
            print("loading", flush=True)
            import OCP.STEPCAFControl

    app.parse = lambda arguments: Command()
    sys.exit(app.main([]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_load_of_the_cad_kernel_can_be_interrupted(number: int, code: int) -> None:
    command = [sys.executable, "-c", textwrap.dedent(LOADS_THE_KERNEL)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None and run.stderr is not None
        assert run.stdout.readline() == "loading\n"
        time.sleep(0.05)  # It takes a second, in which it looks at no signal.
        run.send_signal(number)
        said = run.stderr.read()
    assert (run.returncode, said.count("\n")) == (code, 1), said


def test_a_reader_that_is_gone_ends_a_table_quietly() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "taccel_lab.cli.app", "sensors", "list"]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_reader_that_has_enough_ends_it_quietly() -> None:
    command = (
        f"{sys.executable} -m taccel_lab.cli.app sensors list | head -c 1; echo ${{PIPESTATUS[0]}}"
    )
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout[1:].strip() in ("0", "141")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("press --indentor ball digit", "press has no option --indentor; did you mean --indenter?"),
        ("press --hlp", "press has no option --hlp; did you mean --help?"),
        ("press -out x digit", "press has no option -out; did you mean --out?"),
        ("capture record --scales=x", "capture record has no option --scales; did you mean --sc"),
        ("design --prt 3", "design has no option --prt; did you mean --port?"),
        ("dataset x.toml --limitt 3", "dataset make has no option --limitt; did you mean --limit?"),
        ("preview -dash.png", "preview has no option -dash.png; write a file or folder of that"),
        ("view --zzz", "view has no option --zzz\n"),
    ],
)
def test_an_option_that_is_not_there_is_named_whatever_else_is_missing(
    capsys: pytest.CaptureFixture[str], words: str, told: str
) -> None:
    assert app.main(words.split()) == 2
    captured = capsys.readouterr()
    assert f"error: taccel-lab {told}" in captured.err and captured.out == ""
    assert "--help lists the options" in captured.err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--depth-mm 0,5", "--depth-mm: '0,5' is not a number; decimals have a point: 0.5"),
        ("--force-n 2N", "--force-n: '2N' is not a number; write it without a unit: 2"),
        ("--twist-deg nan", "--twist-deg: 'nan' is not allowed, only finite numbers are"),
        ("--at-mm 1 -inf", "--at-mm: '-inf' is not allowed, only finite numbers are"),
        ("--shear-mm 0.1 x", "--shear-mm: 'x' is not a number"),
        ("--texture=", "--texture: an empty name is not allowed; this folder is written ."),
        ("--element None", "invalid choice 'None' for argument '--element'"),
    ],
)
def test_a_value_that_is_not_allowed_is_told_in_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str, told: str
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit) as caught:
        app.main(["press", "digit", "--out", "x", *words.split()])
    assert caught.value.code == 2
    assert told in capsys.readouterr().err


def test_numbers_are_read() -> None:
    words = "press digit --out x --depth_mm=-0.5 --at-mm -1 2e-1 --tolerance 1"
    command = app.parse(words.split())
    assert isinstance(command, Press)
    assert (command.depth_mm, command.at_mm, command.force_n) == (-0.5, (-1.0, 0.2), None)
    assert isinstance(command.tolerance, float)


@pytest.mark.parametrize("words", ["sensors list --json >&-", "press --help >&-", "zzz 2>&-"])
def test_closed_streams_change_no_exit_code(words: str) -> None:
    command = f"{sys.executable} -m taccel_lab.cli.app {words}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout, done.stderr) == (2 if "zzz" in words else 0, "", "")
