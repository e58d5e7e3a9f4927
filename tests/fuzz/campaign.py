# SPDX-License-Identifier: Apache-2.0
"""Many examples in processes that a reader may crash, hang or fill."""

from __future__ import annotations

import faulthandler
import importlib
import os
import re
import traceback
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import TextIO

from taccel_lab.processes.process_pool import Died, Finished, ProcessPool, Underway
from taccel_lab.progress import Progress
from tests.fuzz import memory
from tests.fuzz.example import MUTATION_NAME, Bench, Outcome

BATCH = 20
"""Examples a request."""
LIMIT_S = 90.0
"""For a batch, of which each example takes milliseconds."""
MEMORY_BYTES = 3 << 30
"""More than what the modules take (torch, Warp and SciPy map 2 GiB); what needs more is ended."""

_MOST_ROUNDS = 100
"""Examples of a batch that die are as many rounds; more means that nothing works."""
_OURS = re.compile(
    r'File "[^"]*?/((?:taccel_lab|calibration|cad|sensors|studies|cli)/[^"]*)", line \d+ in (\w+)'
)
Batch = tuple[str, tuple[int, ...]]
"""A reader and seeds."""


def run(
    examples: Iterable[tuple[str, int]],
    processes: int,
    folder: Path,
    *,
    table: str = "tests.fuzz.readers",
    limit_s: float = LIMIT_S,
) -> Iterator[Outcome]:
    """Outcomes as they come in, in any order.

    Args:
        examples: Readers and seeds.
        processes: That work side by side.
        folder: For guarded folders and crash reports.
        table: Module that holds the ``READERS``.
        limit_s: For a batch of examples.
    """
    folder.mkdir(parents=True, exist_ok=True)
    waiting, rounds = list(_batches(examples)), 0
    work = partial(_work, str(folder), table, limit_s)
    with ProcessPool(work, processes, limit_s) as pool:
        while waiting:
            rounds += 1
            if rounds > _MOST_ROUNDS:
                raise RuntimeError(f"processes keep dying: {waiting[:3]} ...")
            left: list[Batch] = []
            begun: dict[tuple[str, int], str] = {}
            for event in pool.run(waiting):
                if isinstance(event, Underway):
                    reader, seed, process = event.what.split()
                    begun[reader, int(seed)] = process
                elif isinstance(event, Finished):
                    yield from event.result
                elif isinstance(event, Died):
                    outcome, rest = _death(event, begun, folder)
                    left += rest
                    if outcome is not None:
                        yield outcome
            waiting = left


def _batches(examples: Iterable[tuple[str, int]]) -> Iterator[Batch]:
    by_reader: dict[str, list[int]] = {}
    for reader, seed in examples:
        by_reader.setdefault(reader, []).append(seed)
    for reader, seeds in by_reader.items():
        for begin in range(0, len(seeds), BATCH):
            yield reader, tuple(seeds[begin : begin + BATCH])


def _death(
    event: Died[Batch], begun: Mapping[tuple[str, int], str], folder: Path
) -> tuple[Outcome | None, list[Batch]]:
    """The example that a process died of, and the others of its batch.

    The others are run again: their outcomes died with the process. None where it is not certain
    which example it was: on a machine that is busy, many may take longer than the limit, or all
    that the process imports. Then they are tried again, the last one alone.
    """
    reader, seeds = event.item
    guilty = [seed for seed in seeds if (reader, seed) in begun][-1:]
    rest = tuple(seed for seed in seeds if seed not in guilty)
    kind = "hang" if event.cause.startswith("no answer") else "crash"
    if not guilty or (kind == "hang" and rest):
        return None, [(reader, part) for part in (tuple(guilty), rest) if part]
    process = begun[reader, guilty[0]]
    # Reports of earlier examples, which were slow and ended well, stand before the last one.
    report = re.split("Fatal Python error|Timeout", _text(folder / f"{process}.txt"))[-1]
    ours = _OURS.findall(report)
    own = ("taccel_lab/processes/child_process.py", "taccel_lab/processes/process_pool.py")
    frames = [frame for frame in ours if frame[0] not in own]
    where = f"{kind} in {frames[0][0]}:{frames[0][1]}" if frames else kind
    words = _text(folder / process / MUTATION_NAME)
    outcome = Outcome(reader, guilty[0], words, kind, event.cause, where)
    return outcome, [(reader, rest)] if rest else []


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


@cache
def _bench(folder: str, table: str) -> Bench:
    """This process's own, with its limits."""
    faulthandler.enable(_report(folder))
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # Libraries print past Python.
        os.dup2(silent, stream)
    memory.limit(MEMORY_BYTES)
    return Bench(Path(folder) / str(os.getpid()), importlib.import_module(table).READERS)


@cache
def _report(folder: str) -> TextIO:
    return open(Path(folder) / f"{os.getpid()}.txt", "w", encoding="utf-8")


def _work(folder: str, table: str, limit_s: float, batch: Batch, tell: Progress) -> list[Outcome]:
    reader, seeds = batch
    outcomes = []
    try:
        _bench(folder, table).sample(reader)
    except Exception:
        words = traceback.format_exc()[-1500:]
        return [Outcome(reader, seed, "none", "suite", words) for seed in seeds]
    for number, seed in enumerate(seeds):
        tell(f"{reader} {seed} {os.getpid()}", number, len(seeds))
        faulthandler.dump_traceback_later(0.8 * limit_s, file=_report(folder))
        try:
            outcomes.append(_bench(folder, table).run(reader, seed))
        except Exception:  # A fault of the suite, which has to be seen.
            outcomes.append(Outcome(reader, seed, "?", "suite", traceback.format_exc()[-1500:]))
        finally:
            faulthandler.cancel_dump_traceback_later()
    return outcomes
