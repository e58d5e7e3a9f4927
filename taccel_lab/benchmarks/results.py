# SPDX-License-Identifier: Apache-2.0
"""Suites and their result files: one schema, written whole after every row, so that nothing that is
finished is lost; a page says what was measured, on which machine, with a table of the rows."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from taccel_lab.errors import InputError, keeping
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.documents import read_json
from taccel_lab.files.output_folder import require_growable
from taccel_lab.files.regular_file import shown
from taccel_lab.report.machine import describe_run
from taccel_lab.report.page import Page, Table, format_number, sentence, write_page_file

SIDE_BY_SIDE = 5
"""Rows that stand beside one another, a line for each of their figures; more stand one below the
other."""
COLUMNS = 6
"""Columns of a table of many rows, which goes on in another."""


def benchmark_page(document: dict[str, Any], shown: Sequence[str] = ()) -> Page:
    """The page of a result file (``read_result``); ``shown``: see ``Suite``, they come first."""
    rows = [dict(flat(row)) for row in document["rows"]]
    state = "all rows" if document["complete"] else "not complete"
    seconds = format_number(document["seconds"])
    own = ("schema", "suite", "what", "run", "settings", "complete", "rows", "seconds")
    beside = dict(flat({k: v for k, v in document.items() if k not in own}))
    return Page(
        title=f"Benchmark {document['suite']}",
        summary=f"{sentence(document['what'])} Measured in {seconds} s, {state}.",
        headline=_headline(document["rows"]),
        tables=[
            *(
                [Table("Figures of the whole", ("figure", "value"), list(beside.items()))]
                * bool(beside)
            ),
            *_tables(rows, shown),
            Table("Settings", ("setting", "value"), list(flat(document["settings"])), folded=True),
            Table("Machine", ("figure", "value"), list(flat(document["run"])), folded=True),
        ],
    )


def _headline(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many goals were met, where there are any."""
    met = [row["met"] for row in rows if "met" in row]
    return f"{sum(map(bool, met))} of {len(met)} goals met" if met else f"{len(rows)} rows"


def _tables(rows: list[dict[str, Any]], shown: Sequence[str]) -> Iterator[Table]:
    """Rows side by side where they are few, otherwise as many columns at a time as a page takes:
    what rows are about, the figures ``shown``, the others, and apart what all rows have alike."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    if not names:
        return
    if len(rows) <= SIDE_BY_SIDE:
        first, *others = names
        columns = ["figure", *(str(row.get(first, number)) for number, row in enumerate(rows, 1))]
        yield Table("Rows", columns, [[n, *(row.get(n) for row in rows)] for n in others])
        return
    alike = [n for n in names[1:] if all(row.get(n) == rows[0].get(n) for row in rows)]
    first, *others = (name for name in names if name not in alike)

    def rank(name: str) -> int:
        if any(isinstance(row.get(name), str) for row in rows):
            return 0
        return 1 if name in shown else 2

    others.sort(key=rank)
    for start in range(0, max(1, len(others)), COLUMNS):
        part = others[start : start + COLUMNS]
        cells = [[row.get(name) for name in (first, *part)] for row in rows]
        title = f"Rows: {part[0]} to {part[-1]}" if start else "Rows"
        yield Table(title, (first, *part), cells, folded=start > 0)
    if alike:
        cells = [[name, rows[0].get(name)] for name in alike]
        yield Table("The same in all rows", ("figure", "value"), cells, folded=True)


def flat(table: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Figures by their names, those of inner tables after the table's."""
    for name, value in table.items():
        if isinstance(value, dict):
            yield from flat(value, f"{before}{name}: ")
        elif isinstance(value, bool):
            yield before + name, "yes" if value else "no"
        elif isinstance(value, (list, tuple)):
            yield before + name, ", ".join(map(format_number, value))
        else:
            yield before + name, value


SCHEMA = "taccel-lab benchmark 1"
REQUIRED = ("schema", "suite", "what", "run", "settings", "complete", "rows", "seconds")


class ResultFile:
    """Rows of one suite; every ``add`` writes the file anew, atomically."""

    def __init__(
        self,
        suite: str,
        what: str,
        out: Path,
        device: str,
        settings: dict[str, Any],
        budget_s: float | None = None,
        shown: tuple[str, ...] = (),
    ) -> None:
        """``out``: a folder, or a JSON file, refused where nothing can be written; ``budget_s`` and
        ``shown``: see ``Suite``."""
        self.path = out if out.suffix == ".json" else out / f"{suite}.json"
        require_growable(self.path.parent)
        self.deadline = Deadline(budget_s)
        self._shown = shown
        self._started = time.perf_counter()
        self._document: dict[str, Any] = {
            "schema": SCHEMA,
            "suite": suite,
            "what": what,
            "run": describe_run(device),
            "settings": settings,
            "complete": False,
            "rows": [],
            "seconds": 0.0,
        }

    @property
    def rows(self) -> list[dict[str, Any]]:
        """What is finished."""
        return self._document["rows"]

    def add(self, row: dict[str, Any], label: str) -> None:
        """Keep a finished row and show its main figures."""
        self.rows.append(row)
        self.write()
        figures = dict(flat(row))
        shown = [
            f"{n} {format_number(figures[n])}" for n in self._shown if figures.get(n, "") != ""
        ]
        note(f"{label}: {', '.join(shown)}")

    def measure(self, label: str, measure: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
        """Measure a row and add it; None once the budget is spent."""
        if self.deadline.passed:
            note(f"{label}: not started, the budget is spent")
            return None
        row = measure()
        self.add(row, label)
        return row

    def put(self, name: str, value: Any) -> None:
        """A figure beside the rows."""
        self._document[name] = value
        self.write()

    def replace(self, rows: list[dict[str, Any]], **figures: Any) -> None:
        """Other rows in place of those so far, and figures beside them."""
        self._document |= {"rows": rows, **figures}
        self.write()

    def get(self, name: str, default: Any = None) -> Any:
        """A figure that was put beside the rows."""
        return self._document.get(name, default)

    def write(self) -> None:
        self._document["seconds"] = round(time.perf_counter() - self._started, 1)
        write_json(self.path, self._document)

    @contextmanager
    def finishing(self) -> Iterator[ResultFile]:
        """Mark the file complete at the end, unless the budget ended it; what ends it before is
        told what is kept."""
        what = "{} finished rows stay in {}".format
        with keeping(lambda: what(len(self.rows), self.path) if self.rows else ""):
            yield self
        self._document["complete"] = not self.deadline.stopped
        self.write()
        if find_spec("jinja2") is None:
            note(f"wrote {self.path}; a page of it needs jinja2, which is not installed")
            return
        page = self.path.with_suffix(".html")
        write_page_file(benchmark_page(self._document, self._shown), page)
        note(f"wrote {self.path} and {page}")


def read_result(path: Path) -> dict[str, Any]:
    """A result file, checked."""
    document = read_json(path)
    if document.get("schema") != SCHEMA:
        raise InputError(f"{path} is no result of this suite: its schema is not {SCHEMA!r}")
    missing = [name for name in REQUIRED if name not in document]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}")
    rows, whole = document["rows"], (document["run"], document["settings"])
    if not (isinstance(rows, list) and all(isinstance(one, dict) for one in (*whole, *rows))):
        raise InputError(f"{path} is no result of this suite: its rows have to be tables")
    for name in ("suite", "what"):
        if not isinstance(document.get(name, ""), str):
            raise InputError(f"{path}: {name} is {shown(document[name])}; words are needed")
    return document


def spread(values: list[float]) -> dict[str, float]:
    """Median, smallest and largest of repeated measurements, and how many there are."""
    return {
        "median": float(np.median(values)),
        "min": float(min(values)),
        "max": float(max(values)),
        "count": len(values),
    }


def note(line: str) -> None:
    """A line for the person who waits."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


class Deadline:
    """When to stop starting things."""

    def __init__(self, budget_s: float | None) -> None:
        self._end = None if budget_s is None else time.perf_counter() + budget_s
        self.stopped = False
        """Whether something was not started for it."""

    @property
    def passed(self) -> bool:
        """Asked before each thing that is started."""
        self.stopped |= self._end is not None and time.perf_counter() > self._end
        return self.stopped


class Ticker:
    """A line on a terminal that says how far a row is; nothing where output goes to a file."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._last = 0.0
        self._on = sys.stderr.isatty()

    def __call__(self, task: str, done: int, total: int) -> None:
        now = time.perf_counter()
        if not self._on or (now - self._last < 0.2 and done < total):
            return
        self._last = now
        end = "\r\033[K" if done == total else ""
        sys.stderr.write(f"\r\033[K{self._label}, {task}: {done}/{total}{end}")
        sys.stderr.flush()


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Options of a suite; those of one suite stand in its class, with their help below them."""

    name: ClassVar[str]
    """Name of its command and its result file."""
    what: ClassVar[str]
    """A line for the result file."""
    shown: ClassVar[tuple[str, ...]] = ()
    """Figures of a row to show when it is finished, those of inner tables named as on the page; one
    that a row lacks is left out."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    out: Path = Path("out/benchmarks")
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        """What the command does."""
        self.measure()

    def measure(self) -> ResultFile:
        """Measure all rows and write the result file; InputError for options that cannot be."""
        import warp as wp

        from taccel_lab.model.launches import require_device

        require_device(self.device)
        wp.config.log_level = wp.LOG_WARNING
        settings = self.settings()
        result = ResultFile(
            self.name, self.what, self.out, self.device, settings, self.budget_s, self.shown
        )
        with result.finishing():
            self.measure_rows(result)
        return result

    def settings(self) -> dict[str, Any]:
        """What the result file says of the options: those of the suite's own, and what more a
        suite adds."""
        own = {field.name for field in fields(self)} - {field.name for field in fields(Suite)}
        return {name: value for name, value in vars(self).items() if name in own}

    def measure_rows(self, result: ResultFile) -> None:
        """Add a row for everything that the suite measures."""
        raise NotImplementedError
