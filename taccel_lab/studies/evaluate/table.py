# SPDX-License-Identifier: Apache-2.0
"""The table of a study: one row a design, as CSV and, where pyarrow is installed, as Parquet."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_by

if TYPE_CHECKING:
    from taccel_lab.studies.evaluate.design_row import DesignRow
    from taccel_lab.studies.spec.study import Study

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
    from taccel_lab.studies.evaluate.ranking import is_feasible

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
        staging.chmod(0o644)
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
