# SPDX-License-Identifier: Apache-2.0
"""One example: a sound sample, damaged as a seed says, given to a reader that is watched."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from taccel_lab.errors import InputError
from taccel_lab.files import videos
from tests.fuzz import memory
from tests.fuzz.guard import SECRET_WORD, Guard, changes, remove
from tests.fuzz.mutations.draw import Draw
from tests.fuzz.mutations.mutate import mutate
from tests.fuzz.reader import Reader, Refused

MEMORY_BYTES = 1 << 30
"""That an example may add to what its process takes."""
SILENT_S = 3.0
"""That a decoder may take over a frame of a few pixels, a fraction of what users' may."""
MOST_LETTERS = 4000
"""Of a message; a few sentences have fewer."""
MUTATION_NAME = "mutation.txt"
"""File beside the guarded folder that says what was done last, for who finds the process dead."""
_HOME = str(Path(__file__).parents[2])


@dataclass(frozen=True)
class Outcome:
    """What became of one example."""

    reader: str
    seed: int
    mutation: str
    """What was done to the sample."""
    kind: str
    """accepted, refused, or what is wrong: exception, crash, hang, memory, outside, message."""
    message: str = ""
    where: str = ""
    """Exception type and the last line of this project that it passed."""

    @property
    def fault(self) -> bool:
        return self.kind not in ("accepted", "refused")


class Bench:
    """Runs examples of readers, one after the other, in one guarded folder."""

    def __init__(self, root: Path, readers: Mapping[str, Reader]) -> None:
        self._readers = readers
        self._guard = Guard(root / "guarded")
        self._guard.root.mkdir(parents=True, exist_ok=True)
        self._note = root / MUTATION_NAME
        self._samples: dict[str, dict[str, bytes]] = {}
        self._guard.prepare()
        # Whatever a reader leaves behind, it leaves where it is looked for.
        tempfile.tempdir = str(self._guard.temporary)
        os.environ["TMPDIR"] = tempfile.tempdir
        os.chdir(self._guard.here)

    def run(self, name: str, seed: int) -> Outcome:
        """The example of ``seed``."""
        sample = self.sample(name)  # With all the time that it needs to load libraries.
        with patch.object(videos, "_SILENT_S", SILENT_S):
            return self._judged(name, self._readers[name], sample, seed)

    def sample(self, name: str) -> dict[str, bytes]:
        """Files of a reader's sound sample by name; it is tried first, once."""
        if name not in self._samples:
            reader, given = self._readers[name], self._guard.given
            self._guard.prepare()
            reader.make(given)
            sample = {
                str(path.relative_to(given)): path.read_bytes()
                for path in sorted(given.rglob("*"))
                if path.is_file()
            }
            # Loads all that the reader needs, which is then no memory of an example.
            found = self._judged(name, reader, sample, None)
            if found.kind == "outside":  # Compilers of kernels leave files the first time.
                found = self._judged(name, reader, sample, None)
            if found.kind != "accepted":
                raise AssertionError(f"{name}: its own sample is not accepted: {found}")
            self._samples[name] = sample
        return self._samples[name]

    def _judged(
        self, name: str, reader: Reader, sample: dict[str, bytes], seed: int | None
    ) -> Outcome:
        guard = self._guard
        guard.prepare()
        for file, data in sample.items():
            path = guard.given / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        words = "none"
        if seed is not None:
            files = [file for file in sample if reader.damages(file)]
            draw = Draw(f"{name} {seed}")
            words = mutate(
                guard.given, files, draw, guard.outside, reader.seal, larger_counts=reader.counts
            )
        self._note.write_text(words, encoding="utf-8")
        own = None if reader.own is None else guard.given / reader.own
        before = guard.listing(own)
        memory.begin()
        kind, message, where = _called(reader, guard)
        taken = 0 if seed is None else memory.taken()
        if kind == "refused":
            kind, message = _judged_message(message, (*sample, "given"))
        elif kind == "accepted" and (secrets := guard.copied_secrets()):
            kind, message = "outside", f"copied from outside: {', '.join(secrets)}"
        if kind == "refused" and guard.out.exists():
            kind, message = "outside", f"refused, with an output: {message}"
        if changed := changes(before, guard.listing(own)):
            kind, message = "outside", "; ".join(changed[:5])
            self._restore()
        asked = any(reader.may_be_link(f) and (guard.given / f).is_symlink() for f in sample)
        if SECRET_WORD in message and not asked:
            kind = "outside"
        if taken > MEMORY_BYTES and kind in ("accepted", "refused"):
            kind, message = "memory", f"{taken / 2**20:.0f} MiB; {message}"
        return Outcome(name, -1 if seed is None else seed, words, kind, message[:1500], where)

    def _restore(self) -> None:
        for path in self._guard.root.iterdir():
            if path not in (self._guard.here, self._guard.temporary):
                remove(path)
        for folder in (self._guard.here, self._guard.temporary):
            for path in folder.iterdir():
                remove(path)


def _called(reader: Reader, guard: Guard) -> tuple[str, str, str]:
    """Kind, message and place of what happens."""
    try:
        with _quiet():
            reader.call(guard.given, guard.out)
    except (InputError, Refused) as error:
        return "refused", str(error), ""
    except OSError as error:
        # The command line makes a sentence of these (cli/app.py), named by their file.
        if error.errno is None or error.filename is None or error.errno == errno.ENOTDIR:
            return "exception", repr(error)[:600], _place(error)
        return "refused", f"{os.fsdecode(error.filename)}: {error.strerror}", ""
    except MemoryError as error:
        return "memory", repr(error)[:600], _place(error)
    except (Exception, SystemExit) as error:
        return "exception", repr(error)[:600], _place(error)
    return "accepted", "", ""


def _judged_message(message: str, names: tuple[str, ...]) -> tuple[str, str]:
    """Whether a refusal is one to a few sentences about a file."""
    short = message[:800]
    if len(message) > MOST_LETTERS:
        return "message", f"{len(message)} letters: {short}"
    if "Traceback" in message or "errors.pydantic.dev" in message or " object at 0x" in message:
        return "message", f"a programmer's words: {short}"
    if any(ord(letter) < 32 and letter not in "\n\t" for letter in message):
        return "message", f"control characters: {short!r}"
    if not any(Path(name).name in message for name in names):
        return "message", f"names no file: {short}"
    return "refused", message


def _place(error: BaseException) -> str:
    """Type and the last line of ours, without the machine's folders."""
    kind = type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "taccel_lab" in f.filename or _HOME in f.filename]
    ours = [f for f in ours if "/tests/fuzz/" not in f.filename and "/.venv/" not in f.filename]
    if not ours:
        return kind
    last = ours[-1]
    # Rooms are links inside the package: both roads lead to one file.
    file = os.path.relpath(os.path.realpath(last.filename), _HOME)
    return f"{kind} in {file}:{last.name}"


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """No output and no warnings, but the encodings of a terminal."""
    out = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="strict")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        earlier = sys.stdout, sys.stderr
        sys.stdout = sys.stderr = out
        try:
            yield
        finally:
            sys.stdout, sys.stderr = earlier
