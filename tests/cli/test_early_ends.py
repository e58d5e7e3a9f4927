# SPDX-License-Identifier: Apache-2.0
"""Commands that end early, by an error, Ctrl-C or SIGTERM: what they clear away and say."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cli import app
from taccel_lab.datasets import runner
from taccel_lab.datasets.part import PartData
from taccel_lab.errors import InputError, SimulationError, keeping
from taccel_lab.files.output_folder import atomic_directory
from tests.cli.conftest import Cli
from tests.cli.test_app import python


class Raises:
    """A command that ends with the given exception, and keeps ``rows``."""

    def __init__(self, error: BaseException | None, rows: str = "") -> None:
        self.error, self.rows = error, rows

    def run(self) -> None:
        with keeping(lambda: ""), keeping(lambda: self.rows):
            if self.error is not None:
                raise self.error


def caused(error: Exception, cause: BaseException) -> Exception:
    """What a library makes of an interruption while it loads."""
    error.__cause__ = cause
    return error


NOTHING = "; no partial output is left"


@pytest.mark.parametrize(
    ("error", "code", "words", "more"),
    [
        (None, 0, "", ""),
        (InputError("frame 3 is empty"), 2, "error: frame 3 is empty", None),
        (SimulationError("no descent"), 3, "simulation failed: no descent", None),
        (KeyboardInterrupt(), 130, "interrupted", NOTHING),
        (caused(ImportError("initialization"), KeyboardInterrupt()), 130, "interrupted", NOTHING),
        (caused(InputError("not installed"), KeyboardInterrupt()), 130, "interrupted", NOTHING),
        (caused(RuntimeError("__set_name__"), app._Terminated()), 143, "terminated", NOTHING),
        (PermissionError(13, "Permission denied", "/out"), 2, "error: /out: Permission denied", ""),
        (OSError(28, "No space left on device"), 2, "error: No space left on device", ""),
        (OSError(30, "Read-only", b"/out"), 2, "error: /out: Read-only", ""),
        (OSError(28, "No space", "read", None, "written"), 2, "error: written: No space", ""),
    ],
)
@pytest.mark.parametrize("rows", ["", "rows stay in a"])
def test_exit_codes_and_what_stays(
    error: BaseException | None,
    code: int,
    words: str,
    more: str | None,
    rows: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """``more`` is said where nothing stays; None of errors that say nothing of it."""
    if error is not None:
        error.__notes__ = []
        # As readers' processes note where a library raised it.
        error.add_note("Traceback (most recent call last):\n  File ...")
    monkeypatch.setattr(app, "parse", lambda arguments: Raises(error, rows))
    assert app.main([]) == code
    said = f"; {rows}" if rows and error is not None and more is not None else more or ""
    assert capsys.readouterr() == ("", f"{words}{said}\n" if words else "")


@pytest.mark.parametrize("error", [ZeroDivisionError(), OSError("image file is truncated")])
def test_bugs_keep_their_traceback(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(app, "parse", lambda arguments: Raises(error))
    with pytest.raises(type(error)):
        app.main([])


PROGRAM = """
import atexit, os, signal, sys
from contextlib import suppress
from taccel_lab.cli import app
from taccel_lab.files.output_folder import atomic_directory

def again():
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGTERM)

class Command:
    def run(self):
        {body}

app.parse = lambda arguments: Command()
sys.exit(app.main({words}))
"""
WRITES = """with atomic_directory(sys.argv[1]) as folder:
            try:
                (folder / "half.txt").write_text("half")
                os.kill(os.getpid(), signal.{signal})
                (folder / "more.txt").write_text("more")
            finally:
                {last}"""


def ended(body: str, out: Path, code: int, said: str, words: str = "") -> None:
    done = python(PROGRAM.format(body=body, words=words), out)
    told = f"{said}; no partial output is left\n"
    assert (done.returncode, done.stdout, done.stderr) == (code, "", told)


@pytest.mark.parametrize("earlier", [False, True])
def test_asked_to_end_it_clears_away_what_is_unfinished(tmp_path: Path, earlier: bool) -> None:
    if earlier:
        with atomic_directory(tmp_path / "out") as folder:
            (folder / "a.txt").write_text("old")
    before = sorted(path.name for path in tmp_path.rglob("*"))
    body = WRITES.format(signal="SIGTERM", last="pass")
    ended(body, tmp_path / "out", 143, "terminated", "[]")
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    "body",
    [
        "atexit.register(again)\n        " + WRITES.format(signal="SIGINT", last="again()"),
        'exec("os.kill(os.getpid(), signal.SIGINT)")',
        "with suppress(KeyboardInterrupt):\n            os.kill(os.getpid(), signal.SIGINT)\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n        print('not reached')",
    ],
    ids=["twice", "through a text", "swallowed"],
)
def test_further_signals_change_nothing_about_an_interrupt(body: str, tmp_path: Path) -> None:
    """Neither while it clears up nor as the process ends; one that was lost is no first one."""
    ended(body, tmp_path / "new" / "out", 130, "interrupted")
    assert list(tmp_path.iterdir()) == []


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


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_load_of_the_cad_kernel_can_be_interrupted(number: int, code: int) -> None:
    command, pipe = [sys.executable, "-c", textwrap.dedent(LOADS_THE_KERNEL)], subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as run:
        assert run.stdout is not None and run.stderr is not None
        assert run.stdout.readline() == "loading\n"
        time.sleep(0.05)  # It takes a second, in which it looks at no signal.
        run.send_signal(number)
        said = run.stderr.read()
    assert (run.returncode, said.count("\n")) == (code, 1), said


@pytest.mark.thorough
def test_an_interrupted_data_set_says_what_is_kept_and_goes_on(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (room / "set.toml").read_text().replace("episodes = 1", "episodes = 3")
    Path("three.toml").write_text(f"{text}episodes_per_part = 1\n")
    simulate, begun = runner.simulate_parts, []

    def stopped(*args: Any) -> list[PartData]:
        begun.append(args)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return simulate(*args)

    monkeypatch.setattr(runner, "simulate_parts", stopped)
    words = "dataset three.toml --out out --processes 0"
    told = cli(words, code=130).err
    go_on = f"go on with: taccel-lab {words}\n"
    assert f"1 of 3 parts finished and kept in out, others are made anew; {go_on}" in told
    assert cli.json(words)["episodes"] == 2
