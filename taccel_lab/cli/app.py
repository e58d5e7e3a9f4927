# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab``: gathers the sub-commands and turns errors into messages and exit codes.

Exit codes: 0 done, 1 ``doctor``, ``capture check`` or ``dataset check`` found something broken,
``force`` read images unlike its training's, a stage of ``calibrate all`` had unfit captures or no
design of a ``study`` keeps its constraints, 2 unusable input or usage, or files that cannot be read
or written, as on a full disk, 3 a simulation that did not converge, 130 interrupted (pages end so),
143 asked to end (SIGTERM). Anything else that goes wrong is a bug and keeps its traceback. Command
modules import heavy libraries inside ``run()`` only, so that help is fast.
"""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from taccel_lab.errors import (
    InputError,
    InputWarning,
    SimulationError,
    causes,
    file_sentence,
    is_of_a_file,
    kept_notes,
)
from taccel_lab.printable import readable

OLD_NAMES = {"import-step": "import-gel"}
"""Names that commands had, still understood."""
_COLLECT_AFTER = 100_000
"""New objects after which Python looks for those that only hold each other."""
DESCRIPTION = """Design and calibrate vision-based tactile sensors.

From a parametric gel pad to simulated presses, a calibration to real captures block by block, and
an exported sensor profile.

taccel-lab COMMAND --help shows the options of a command. All commands take --quiet, which prints
only results and errors. --device auto uses a GPU if there is one. taccel-lab --version prints the
version, --tyro-print-completion bash (or zsh, tcsh) the completion of a shell."""


class Command(Protocol):
    """A parsed sub-command."""

    def run(self) -> None: ...


@dataclass(frozen=True)
class Group:
    """Commands behind one word."""

    help: str
    commands: Mapping[str, type[Command]]


def command_tree() -> dict[str, type[Command] | Group]:
    """The commands by name; imported here so that other imports of this module are light."""
    from taccel_lab.cli import (
        bench,
        calibrate,
        calibrate_all,
        capture,
        capture_record,
        catalogue,
        dataset,
        demo,
        design,
        doctor,
        live,
        press,
        profile,
        read,
        study,
        task,
    )

    blocks = {
        **calibrate.block_commands(),
        "all": calibrate_all.CalibrateAll,
        "force": calibrate.CalibrateForce,
        "refit": calibrate.CalibrateRefit,
    }
    return {
        "demo": demo.Demo,
        "design": design.Design,
        "import-gel": design.ImportGel,
        "preview": design.Preview,
        "press": press.PressCommand,
        "capture": Group(
            "Plan, record, import, label, check and rectify captures.",
            {
                "check": capture.CaptureCheckCommand,
                "guide": capture.CaptureGuide,
                "devices": capture.CaptureDevices,
                "record": capture_record.CaptureRecord,
                "quick": capture_record.CaptureQuick,
                "import": capture.CaptureImport,
                "label": capture_record.CaptureLabel,
                "rectify": capture.CaptureRectify,
            },
        ),
        "depth": read.Depth,
        "read": read.Read,
        "live": live.Live,
        "force": read.Force,
        "calibrate": Group(
            "Fit the blocks of a profile to real captures.", dict(sorted(blocks.items()))
        ),
        "profile": Group(
            "Show, check, compare or report on sensor profiles.",
            {
                "show": profile.ProfileShow,
                "validate": profile.ProfileValidate,
                "report": profile.ProfileReport,
                "add-view": profile.ProfileAddView,
            },
        ),
        "export": profile.Export,
        "sensors": Group(
            "List the sensors of the catalogue.",
            {"list": catalogue.SensorsList, "show": catalogue.SensorsShow},
        ),
        "robot": Group(
            "Robots that can carry gels, by name or from URDF.",
            {"list": catalogue.RobotList, "show": catalogue.RobotShow},
        ),
        "task": Group(
            "Tasks with criterion, seeds and a baseline policy.",
            {"list": task.TaskList, "run": task.TaskRun, "record": task.TaskRecord},
        ),
        "study": study.StudyCommand,
        "dataset": Group(
            "Make data sets of simulated touches; check and export them.", dataset.COMMANDS
        ),
        "view": live.ViewCommand,
        "bench": bench.BenchCommand,
        "doctor": doctor.Doctor,
    }


def parse(arguments: Sequence[str] | None = None) -> Command:
    """Parse command-line arguments; usage errors and --help leave through SystemExit (2 and 0)."""
    from taccel_lab.cli.bench import parse_bench
    from taccel_lab.cli.console import be_quiet
    from taccel_lab.cli.dataset import with_make
    from taccel_lab.cli.words import checked_words, common_words, require_options, values

    words, quiet = common_words(sys.argv[1:] if arguments is None else arguments)
    words = with_make(words)
    words[:1] = [OLD_NAMES.get(word, word) for word in words[:1]]
    be_quiet(quiet)
    if words[:1] == ["bench"]:
        return parse_bench(words[1:])

    import tyro
    from tyro.extras import SubcommandApp

    tree = command_tree()
    names = {
        name: tuple(one.commands) if isinstance(one, Group) else () for name, one in tree.items()
    }
    words = checked_words(words, names)
    named = tree.get(words[0])
    depth = 2 if isinstance(named, Group) else 1
    command = named.commands.get(words[1]) if isinstance(named, Group) else named
    if command is not None:
        require_options(words[depth:], command, " ".join(["taccel-lab", *words[:depth]]))
    app = SubcommandApp()
    for name, one in tree.items():
        if not isinstance(one, Group):
            app.command(name=name)(one)
            continue
        group = SubcommandApp()
        for inner, command in one.commands.items():
            group.command(name=inner)(command)
        app.command(group, name=name, help=one.help)
    return app.cli(
        prog="taccel-lab",
        description=DESCRIPTION,
        args=words,
        config=(tyro.conf.PositionalMetavarFromFieldName,),
        registry=values(for_completion=any(word.startswith("--tyro-") for word in words)),
    )


def main(
    arguments: Sequence[str] | None = None,
    parsed: Callable[[Sequence[str]], Command] | None = None,
) -> int:
    """Run ``taccel-lab``, or the command that ``parsed`` makes of words; return the exit code."""
    if arguments is None:
        # Python looks for garbage in circles once more when the process ends, which takes half a
        # second of all that a press has loaded: memory goes back whole.
        atexit.register(gc.freeze)
    with _interruptible(last=arguments is None) as settle:
        try:
            with _rarely_collected():
                _run(sys.argv[1:] if arguments is None else arguments, parsed or parse)
            settle()
        except BaseException as error:
            # While the error is at hand, by which a second signal is known.
            settle()
            return _exit_code(error)
    return 0


def _run(words: Sequence[str], parsed: Callable[[Sequence[str]], Command]) -> None:
    import logging

    # A shell can close either (>&-): Python then has none, where libraries expect one.
    sys.stdout = sys.stdout or open(os.devnull, "w")
    sys.stderr = sys.stderr or open(os.devnull, "w")
    for stream in (sys.stdout, sys.stderr):
        # File names may hold bytes that no text has, and a terminal may know ASCII alone.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    from taccel_lab.cli.console import only_json
    from taccel_lab.processes.cache_place import place_fonts

    place_fonts()
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    as_json = "--json" in words and not {"-h", "--help"} & set(words)
    with warnings.catch_warnings(), only_json() if as_json else nullcontext():
        warnings.showwarning = partial(_show_warning, warnings.showwarning)
        parsed(words).run()


def _show_warning(otherwise: Callable[..., None], message: Warning | str, *where: Any) -> None:
    """Ours are notes to users; those of libraries stay as they are."""
    if isinstance(message, InputWarning):
        sys.stderr.write(f"note: {message}\n")
    else:
        otherwise(message, *where)


def _exit_code(error: BaseException) -> int:
    """The exit code for what ended a command, its message written; raises bugs again."""
    if isinstance(error, SystemExit):
        if isinstance(error.__context__, BrokenPipeError):  # rich says 1 for it.
            return 141
        raise error
    notes = kept_notes(error)
    if _is_one_of(_Terminated, error):
        return _fail(143, f"terminated; {notes or 'no partial output is left'}")
    if _is_one_of(KeyboardInterrupt, error):
        # Of one that came up through ``exec`` of a text, as dataclasses are made, Python would die
        # at its end, whoever caught it; the next ``exec`` of a text lifts that.
        exec("")
        return _fail(130, f"interrupted; {notes or 'no partial output is left'}")
    if isinstance(error, InputError):
        return _fail(2, f"error: {error}")
    if isinstance(error, SimulationError):
        return _fail(3, f"simulation failed: {error}")
    if isinstance(error, BrokenPipeError):
        # Whoever read the output, such as `head`, has enough of it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    if is_of_a_file(error):
        return _fail(2, f"error: {file_sentence(error)}{notes and f'; {notes}'}")
    raise error


def _is_one_of(kind: type[BaseException], error: BaseException | None) -> bool:
    """Whether an exception is of a kind, or came of one."""
    return any(isinstance(one, kind) for one in causes(error))


class _Terminated(BaseException):
    """SIGTERM, as a batch system sends it before it kills: what is unfinished is cleared away."""


_UNWINDING: dict[int, type[BaseException]] = {
    signal.SIGINT: KeyboardInterrupt,
    signal.SIGTERM: _Terminated,
}


def _unwind(number: int, _: object) -> None:
    """Unwind the command, once: while that clears up, further signals change nothing."""
    if not any(_is_one_of(kind, sys.exception()) for kind in _UNWINDING.values()):
        raise _UNWINDING[number]


@contextmanager
def _interruptible(last: bool) -> Iterator[Callable[[], None]]:
    """Let SIGTERM unwind the command as Ctrl-C does; only the main thread may.

    Yields what says that the command is over. Where the process ends with it (``last``), no signal
    disturbs that end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    earlier = {
        number: signal.signal(number, _unwind)
        for number in _UNWINDING
        # One that a shell has a command in the background ignore stays so.
        if signal.getsignal(number) is not signal.SIG_IGN
    }

    def settle() -> None:
        for number, handler in earlier.items():
            signal.signal(number, signal.SIG_IGN if last else handler)

    try:
        yield settle
    finally:
        settle()


@contextmanager
def _rarely_collected() -> Iterator[None]:
    """Look for garbage in circles rarely: what a command loads stays, and walking all of it over
    and over took a tenth of a press."""
    earlier = gc.get_threshold()
    gc.set_threshold(_COLLECT_AFTER, *earlier[1:])
    try:
        yield
    finally:
        gc.set_threshold(*earlier)


def _fail(code: int, message: str) -> int:
    sys.stderr.write(readable(message) + "\n")
    return code


if __name__ == "__main__":
    sys.exit(main())
