# SPDX-License-Identifier: Apache-2.0
"""One page for any calibration: verdict, remarks, tables, pictures; self-contained HTML and JSON.

A calibrator describes its page in these terms and draws its own figures; nothing here knows what
was calibrated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.result import Remark, judge
from taccel_lab.output import write_json
from taccel_lab.output_folder import atomic_directory
from taccel_lab.report.build import data_url, report_environment
from taccel_lab.report.style import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """Rows of cells; numbers are formatted with four significant digits."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn when the page is written, and stored as ``<name>.png``."""

    name: str
    draw: Callable[[], Figure]
    caption: str


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


def write_page(page: Page, folder: Path | str) -> None:
    """Write ``report.html``, ``report.json`` and the pictures as the folder, whole or not at all.

    Raises:
        InputError: The folder holds files that taccel-lab did not write.
    """
    verdict = judge(page.remarks)
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
            .render(page=page, verdict=verdict, images=images)
        )
        (staging / "report.html").write_text(html, encoding="utf-8", errors="backslashreplace")
        remarks = [
            {"severity": r.severity, "code": r.code, "message": r.message} for r in page.remarks
        ]
        write_json(
            staging / "report.json",
            {"title": page.title, "verdict": verdict, "remarks": remarks, **page.figures},
        )
