# SPDX-License-Identifier: Apache-2.0
"""The page ``docs/evidence/benchmarks.md``, its pictures and tables of other pages.

Each page has text of its own; what stands between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``
is replaced. Only files that follow the schema of ``taccel_lab.benchmarks.results`` are read.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taccel_lab.benchmarks.report.sections import HEADLINE, SECTIONS, VERIFICATION, Section
from taccel_lab.benchmarks.results import FOLDER, SCHEMA
from taccel_lab.files.atomic_file import atomic_file
from taccel_lab.report.page_text import with_parts

_ROOT = Path(__file__).resolve().parents[3]
PAGE, README = _ROOT / "docs" / "evidence" / "benchmarks.md", _ROOT / "README.md"
PAGES: dict[Path, dict[str, Section]] = {
    PAGE: SECTIONS,
    README: HEADLINE,
    PAGE.with_name("verification.md"): VERIFICATION,
}
"""Generated parts of each page."""
IMAGES = _ROOT / "docs" / "images" / "benchmarks"
Results = dict[str, list[dict[str, Any]]]


def read_results(folder: Path = FOLDER) -> Results:
    """Result documents by suite; each knows its file's name as ``file``."""
    found: Results = {}
    for path in sorted(folder.glob("*.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(document, dict) and document.get("schema") == SCHEMA:
            found.setdefault(document["suite"], []).append(document | {"file": path.name})
    return found


def render(text: str, sections: dict[str, Section], results: Results) -> str:
    """A page with its generated parts made anew."""
    return with_parts(text, {name: section(results) for name, section in sections.items()})


@dataclass(frozen=True)
class Report:
    """Make docs/evidence/benchmarks.md, its pictures and other pages' tables from the results."""

    results: Path = FOLDER
    """Folder of the results."""
    pictures: bool = True
    """Draw the pictures, too."""
    scenes: bool = False
    """Run the scenes and draw them, too (a minute)."""

    def run(self) -> None:
        results = read_results(self.results)
        written = []
        for page, sections in PAGES.items():
            text = render(page.read_text(encoding="utf-8"), sections, results)
            with atomic_file(page) as target:
                target.write_text(text, encoding="utf-8")
            written.append(page)
        if self.pictures:
            from taccel_lab.benchmarks.report.plots import draw_all

            written += draw_all(results, IMAGES)
        if self.scenes:
            from taccel_lab.benchmarks.report.plots import draw_scenes

            written.append(draw_scenes(IMAGES / "scenes.png"))
        for path in written:
            print(path)
