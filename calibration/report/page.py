# SPDX-License-Identifier: Apache-2.0
"""One page for any calibration: verdict, remarks, tables, pictures; self-contained HTML and JSON.

A calibrator describes its page in these terms and draws its own figures; nothing here knows what
was calibrated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.result import Remark, Severity, judge
from taccel_lab.output import write_json
from taccel_lab.output_folder import atomic_directory
from taccel_lab.report.build import data_url, report_environment
from taccel_lab.report.style import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.report.mesh_view import MeshView

MOST_TO_DO = 3
VERDICT_CODES = ("weak_block", "usable_block")
"""Of remarks that only repeat a block's verdict."""


@dataclass(frozen=True)
class Table:
    """Rows of cells; numbers are formatted with four significant digits."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    folded: bool = False
    """Whether it comes after the pictures, under its title until somebody opens it."""

    def shown(self) -> Table:
        """Without columns that hold nothing."""
        keep = [
            i
            for i, name in enumerate(self.columns)
            if not name or i == 0 or any(row[i] not in (None, "", "–") for row in self.rows)
        ]
        columns = [self.columns[i] for i in keep]
        return replace(self, columns=columns, rows=[[row[i] for i in keep] for row in self.rows])


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn when the page is written, and stored as ``<name>.png``."""

    name: str
    draw: Callable[[], Figure]
    caption: str
    view: MeshView | None = None
    """What the reader can turn in its place; print and pages without scripts show the picture."""


@dataclass(frozen=True)
class Page:
    """What a report of one calibration says."""

    title: str
    summary: str
    """One paragraph: what was fitted to what, and how well."""
    remarks: Sequence[Remark] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    figures: dict[str, Any] = field(default_factory=dict)
    """Everything measured, written as JSON beside the page."""
    files: dict[str, Callable[[Path], None]] = field(default_factory=dict)
    """Other files beside the page: name, and what writes it."""


def to_do_first(remarks: Sequence[Remark]) -> tuple[list[Remark], list[Remark]]:
    """What to do first, at most ``MOST_TO_DO`` remarks, the gravest first; and the others.

    A block's own verdict is nothing to do: what it rests on is.
    """
    asked = [r for r in remarks if r.severity != Severity.INFO and r.code not in VERDICT_CODES]
    first = sorted(asked, key=lambda remark: remark.severity != Severity.ERROR)[:MOST_TO_DO]
    return first, [remark for remark in remarks if remark not in first]


def write_page(page: Page, folder: Path | str) -> None:
    """Write ``report.html``, ``report.json`` and the pictures as the folder, whole or not at all.

    Raises:
        InputError: The folder holds files that taccel-lab did not write.
    """
    verdict = judge(page.remarks)
    to_do, others = to_do_first(page.remarks)
    with atomic_directory(folder) as staging:
        images = {}
        for picture in page.pictures:
            path = staging / f"{picture.name}.png"
            save_figure(picture.draw(), path)
            images[picture.name] = data_url(path)
        for name, write in page.files.items():
            write(staging / name)
        html = (
            report_environment("taccel_lab.calibration.report")
            .get_template("page.html.j2")
            .render(
                page=page,
                verdict=verdict,
                to_do=to_do,
                others=others,
                tables=[table.shown() for table in page.tables],
                images=images,
            )
        )
        (staging / "report.html").write_text(html, encoding="utf-8", errors="backslashreplace")
        remarks = [
            {"severity": r.severity, "code": r.code, "message": r.message} for r in page.remarks
        ]
        write_json(
            staging / "report.json",
            {"title": page.title, "verdict": verdict, "remarks": remarks, **page.figures},
        )
