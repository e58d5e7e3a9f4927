# SPDX-License-Identifier: Apache-2.0
"""Writes a study's report: one self-contained HTML page, its figures as PNG files, and the JSON."""

from __future__ import annotations

from typing import Any

from taccel_lab.report.page import write_page_into
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.page import FIGURES, study_page


def write_study_report(outcome: StudyOutcome) -> dict[str, Any]:
    """Write ``report.html``, ``report.json`` and ``figures/*.png`` into the study's folder.

    Returns:
        The figures as written to the JSON.
    """
    page, root = study_page(outcome), outcome.folder.root
    (root / FIGURES).mkdir(exist_ok=True)
    write_page_into(page, root)
    drawn = {picture.name for picture in page.pictures}
    for path in (root / FIGURES).glob("*.png"):
        if f"{FIGURES}/{path.stem}" not in drawn:
            path.unlink()
    return page.figures
