# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture review``: a page with every contact that was found, worst first."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CaptureReview:
    """Find the contact circle of every ball press and show them on a page, the worst first.

    Also writes contacts.toml with the circles found: correct it where it is wrong and copy it into
    the capture folder; all commands that read the folder then use your circles. Exit code 0: all
    presses are usable; 1: a press shows no contact, or the ball cannot be the stated one; 2: bad
    input.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    out: Path | None = None
    """Folder to write: report.html, report.json, contacts.toml and one picture for each press;
    <captures>_review when left out."""
    contacts: Path | None = None
    """A contacts.toml to take into account; that of the capture folder when left out."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture import load_captures
        from taccel_lab.calibration.capture.overrides import with_overrides
        from taccel_lab.calibration.contacts.report import review_page
        from taccel_lab.calibration.contacts.review import review_contacts
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.files.inner_path import real_path
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.progress import stage_progress
        from taccel_lab.report.page import write_page
        from taccel_lab.report.remark import Severity, judge

        console = notes()
        source = real_path(self.captures)
        name = source.stem if source.is_file() else source.name
        out = self.out or source.with_name(f"{name}_review")
        require_replaceable(out)
        captures = load_captures(self.captures)
        if self.contacts is not None:
            captures = with_overrides(captures, self.contacts)
        with stage_progress(console) as progress:
            review = review_contacts(captures, progress)
        write_page(review_page(review), out)
        if self.json:
            print_json(review.figures())
        for remark in review.remarks:
            console.print(str(remark))
        console.print(f"verdict: {judge(review.remarks)}")
        console.print(f"wrote {out / 'report.html'}")
        stopped = any(remark.severity == Severity.ERROR for remark in review.remarks)
        if stopped or review.found.refusals:
            raise SystemExit(1)
