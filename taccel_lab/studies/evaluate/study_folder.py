# SPDX-License-Identifier: Apache-2.0
"""The folder of a study: grown design by design, never replaced as a whole, one run at a time.

::

    .taccel_lab_study     marks the folder, and is locked while a run works in it
    study.toml            the study file as last run
    designs.csv           the table, a row each design
    designs/ID/           result.json, picture and presses of a design
    meshes/, steps/       of each different pad
    report.html           and report.json, figures/

Each file appears whole or not at all, so that a run may be killed at any time.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_by, write_json
from taccel_lab.files.growing_file import held_file
from taccel_lab.files.inner_path import inner_path, require_inner_files
from taccel_lab.files.output_folder import may_hold, require_growable
from taccel_lab.files.shard import Shard
from taccel_lab.studies.evaluate.design_row import DesignRow, is_feasible, read_row

if TYPE_CHECKING:
    from taccel_lab.studies.spec.study import Study


STUDY_MARKER = ".taccel_lab_study"
"""A marker for studies: no other command takes the folder for an output that it may replace."""
RESULT = "result.json"


class StudyFolder:
    """Results of a study on disk."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(os.path.abspath(root))

    @property
    def designs(self) -> Path:
        return self.root / "designs"

    def design(self, design_id: str) -> Path:
        """Folder of one design."""
        return self.designs / design_id

    def require_usable(self) -> None:
        """Refuse a path with a file in the way, or a folder with files of somebody else."""
        if not may_hold(self.root, STUDY_MARKER):
            raise InputError(
                f"{self.root} holds files and no study; name a new folder, an empty one, or that "
                "of an earlier study to go on with it"
            )
        # Not those of submitit's jobs: it leaves links, which a study that was moved takes along.
        require_inner_files(self.root, levels=1)
        for name in ("designs", "figures", "meshes", "steps"):
            require_inner_files(self.root / name)
        if self.is_study() or not self.root.is_dir():
            # Not into an empty folder: a shard that begins there too would take it for foreign.
            require_growable(self.root)

    def is_study(self) -> bool:
        """Whether a study has been begun here."""
        return (self.root / STUDY_MARKER).is_file()

    @contextmanager
    def locked(self, shard: Shard | None = None) -> Iterator[None]:
        """Hold the folder, or a shard's part of it; raises InputError while another run does.

        Shards of one study share the folder. The lock ends with the process, so that a killed run
        leaves none behind.
        """
        self.require_usable()
        self.root.mkdir(parents=True, exist_ok=True)
        busy, marker = f"another run works in {self.root}", self.root / STUDY_MARKER
        advice = "wait for its end or name another folder"
        with held_file(marker, busy, advice, shared=shard is not None):
            if shard is None:
                self._sweep_up()
                try:
                    yield
                finally:
                    # Processes that an error or Ctrl-C ended may have been writing.
                    self._sweep_up()
                return
            self.designs.mkdir(exist_ok=True)
            own = self.root / f".shard_{shard.number}_of_{shard.count}"
            busy = f"{busy} at shard {shard.number}/{shard.count}"
            with held_file(own, busy, "wait for its end"):
                yield

    def _sweep_up(self) -> None:
        """Remove temporary files of processes that were ended while they wrote."""
        self.designs.mkdir(exist_ok=True)
        names = (".designs.*", ".report.*", "designs/*/.*", "figures/.*", "meshes/.*", "steps/.*")
        for pattern in names:
            for path in self.root.glob(pattern):
                if path.is_file():
                    path.unlink()

    def add_row(self, row: DesignRow) -> None:
        """Write the row of a design, its last file: with it the design counts as evaluated.

        What an earlier row knows besides stays.
        """
        earlier = self.read(row.id)
        row = row if earlier is None else earlier.merged(row)
        write_json(self.design(row.id) / RESULT, row.to_json())

    def read(self, design_id: str) -> DesignRow | None:
        """The row of a design; None for one that has not been evaluated."""
        path = inner_path(self.root, f"designs/{design_id}/{RESULT}")
        if not path.is_file():
            return None
        row = read_row(path)
        if row.id != design_id:
            raise InputError(f"{path} is that of another design, {row.id}")
        return row

    def ids(self) -> list[str]:
        """Ids of all designs that have a row, sorted."""
        if not self.designs.is_dir():
            return []
        return sorted(path.parent.name for path in self.designs.glob(f"[!.]*/{RESULT}"))

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the study."""
        with atomic_file(self.root / name) as staging:
            staging.write_text(text, encoding="utf-8", errors="backslashreplace")


CSV_NAME = "designs.csv"
PARQUET_NAME = "designs.parquet"


def columns(study: Study) -> list[str]:
    """Names of the columns: parameters, metrics, how it went, and the design's folder."""
    swept = [axis.name for axis in study.axes]
    names = [*swept, *study.spec.tied]
    for name, metric in study.metrics.items():
        names += [name, *interval_columns(name)] if metric.presses else [name]
    names += ["feasible"] if study.spec.constraints else []
    return [*names, "status", "cause", "simulations", "seconds", "design"]


def interval_columns(name: str) -> tuple[str, str]:
    """Names of the columns of both ends of a figure's interval."""
    return f"{name} low", f"{name} high"


def table_rows(study: Study, designs: Sequence[DesignRow]) -> list[dict[str, Any]]:
    """Rows of the table; None where a figure is missing."""
    names = columns(study)
    rows = []
    for design in designs:
        row: dict[str, Any] = {"design": design.id, **design.parameters, **design.figures}
        for name, ends in design.intervals.items():
            row |= dict(zip(interval_columns(name), ends, strict=True))
        row["feasible"] = is_feasible(design, study.spec.constraints)
        row |= {"status": design.status, "cause": design.cause}
        row |= {"simulations": design.simulations, "seconds": round(design.seconds, 3)}
        rows.append({name: row.get(name) for name in names})
    return rows


def write_table(root: Path, study: Study, designs: Sequence[DesignRow]) -> None:
    """Write ``designs.csv`` and, with pyarrow, ``designs.parquet``, each whole or not at all."""
    rows, names = table_rows(study, designs), columns(study)
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    with atomic_file(root / CSV_NAME) as staging:
        staging.write_text(text.getvalue(), encoding="utf-8", errors="backslashreplace")
    if has_parquet():
        _write_parquet(root / PARQUET_NAME, rows, names)


def has_parquet() -> bool:
    """Whether pyarrow is installed."""
    return find_spec("pyarrow") is not None


def _write_parquet(path: Path, rows: list[dict[str, Any]], names: list[str]) -> None:
    import pyarrow  # pyright: ignore[reportMissingImports]
    import pyarrow.parquet  # pyright: ignore[reportMissingImports]

    columns = {}
    for name in names:
        try:
            columns[name] = pyarrow.array([row[name] for row in rows])
        except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):
            raise InputError(
                f"{path.parent}: values of {name!r} are of different kinds: a result.json "
                "is damaged"
            ) from None
    table = pyarrow.table(columns)
    write_by(path, lambda file: pyarrow.parquet.write_table(table, file))


def _cell(value: Any) -> Any:
    """A cell of the CSV: empty for None, all digits of a number."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else value
