# SPDX-License-Identifier: Apache-2.0
"""Commands that end early, by Ctrl-C, SIGTERM or a full disk: what they clear away and say."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from taccel_lab.cli import app
from taccel_lab.errors import InputError, keeping
from taccel_lab.files.output_folder import atomic_directory
from tests.cli.test_app import Raises, python

TERMINATED = """
    import os, signal, sys
    from pathlib import Path
    from taccel_lab.cli import app
    from taccel_lab.files.output_folder import atomic_directory

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
    done = python(TERMINATED, out)
    told = "terminated; no partial output is left\n"
    assert (done.returncode, done.stderr) == (143, told)
    assert sorted(path.name for path in tmp_path.rglob("*")) == before


TWICE = """
    import atexit, os, signal, sys
    from taccel_lab.cli import app
    from taccel_lab.files.output_folder import atomic_directory

    def again():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGTERM)

    class Command:
        def run(self):
            with atomic_directory(sys.argv[1]) as folder:
                try:
                    (folder / "half.txt").write_text("half")
                    os.kill(os.getpid(), signal.SIGINT)
                finally:
                    again()

    atexit.register(again)
    app.parse = lambda arguments: Command()
    sys.exit(app.main())
"""
THROUGH_A_TEXT = """
    import sys
    from taccel_lab.cli import app

    class Command:
        def run(self):
            exec("import os, signal; os.kill(os.getpid(), signal.SIGINT)")

    app.parse = lambda arguments: Command()
    sys.exit(app.main())
"""
SWALLOWED = """
    import os, signal, sys
    from contextlib import suppress
    from taccel_lab.cli import app

    class Command:
        def run(self):
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
            print("not reached")

    app.parse = lambda arguments: Command()
    sys.exit(app.main())
"""


@pytest.mark.parametrize("code", [TWICE, THROUGH_A_TEXT, SWALLOWED])
def test_further_signals_change_nothing_about_an_interrupt(code: str, tmp_path: Path) -> None:
    """Neither while it clears up nor as the process ends; one that was lost is no first one."""
    done = python(code, tmp_path / "new" / "out")
    told = "interrupted; no partial output is left\n"
    assert (done.returncode, done.stdout, done.stderr) == (130, "", told)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (KeyboardInterrupt(), 130, "interrupted; rows stay in a"),
        (app._Terminated(), 143, "terminated; rows stay in a"),
        (OSError(28, "No space left on device", "b"), 2,
         "error: b: No space left on device; rows stay in a"),
        (OSError(28, "No space left on device", "read", None, "written"), 2,
         "error: written: No space left on device; rows stay in a"),
        (InputError("frame 3 is empty"), 2, "error: frame 3 is empty"),
    ],
)  # fmt: skip
def test_what_stays_is_said(
    error: BaseException,
    code: int,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Keeps(Raises):
        def run(self) -> None:
            with keeping(lambda: ""), keeping(lambda: "rows stay in a"):
                super().run()

    # As readers' processes note where a library raised it.
    error.add_note("Traceback (most recent call last):\n  File ...")
    monkeypatch.setattr(app, "parse", lambda arguments: Keeps(error))
    assert app.main([]) == code
    assert capsys.readouterr().err == f"{told}\n"


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
