# SPDX-License-Identifier: Apache-2.0
"""A calibration of several blocks as one page: what they achieved, and the way to each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from taccel_lab.calibration.blocks import block_named
from taccel_lab.calibration.profile_page import profile_page
from taccel_lab.calibration.remarks import BLOCK
from taccel_lab.calibration.unfinished import BlockOutcome
from taccel_lab.files.documents import read_json
from taccel_lab.profile import SensorProfile
from taccel_lab.report.lead import Link, Picture
from taccel_lab.report.page import PAGE, REPORT, Page, Table

MAPS = "maps.npz"
"""File of the maps beside the page."""


def calibration_page(profile: SensorProfile, blocks: Sequence[BlockOutcome], report: Path) -> Page:
    """The picture that says most, the scores, a line a block; then the profile's own page.

    Args:
        profile: What came out.
        blocks: How each block ended.
        report: Folder that holds their pages, each in a folder of its name.
    """
    page = profile_page(profile)
    written = {o.name: read_json(report / o.name / REPORT) for o in blocks if _is_in(report, o)}
    pictures = [
        Picture(f"{name}_first", (report / name / found["file"]).read_bytes, found["caption"])
        for name in telling_first(written)
        for found in written[name]["pictures"][:1]
    ][:1]
    unfit = [
        BLOCK(block=o.name, what=f"{o.state}: {o.message}", grave=True)
        for o in blocks
        if o.is_unfit
    ]
    return replace(
        page,
        remarks=(*unfit, *page.remarks),
        tables=(_blocks(blocks, report), *(replace(table, folded=True) for table in page.tables)),
        pictures=(*pictures, *page.pictures),
        figures={**page.figures, "blocks": [o.figures() for o in blocks]},
        links=[Link("maps of the rectification", MAPS)] if (report / MAPS).is_file() else (),
    )


def telling_first(names: Iterable[str]) -> list[str]:
    """Names of blocks, that first whose picture says most of the whole."""
    return sorted(names, key=lambda name: -block_named(name).telling)


def _is_in(report: Path, outcome: BlockOutcome) -> bool:
    return (report / outcome.name / REPORT).is_file()


def _blocks(blocks: Sequence[BlockOutcome], report: Path) -> Table:
    rows: list[tuple[Any, ...]] = []
    for outcome in blocks:
        links = tuple(_links(report, outcome.name)) if _is_in(report, outcome) else None
        state = f"{outcome.state}: {outcome.message}"
        rows.append((outcome.name, state, links, outcome.seconds or None))
    return Table("Blocks", ("block", "verdict or reason", "look at", "seconds"), rows)


def _links(report: Path, name: str) -> Iterator[Link]:
    """Links to the page of a block, then to its pictures and files."""
    yield Link("page", f"{quote(name)}/{PAGE}")
    for path in sorted((report / name).iterdir()):
        if path.is_file() and path.name != PAGE and not path.name.startswith("."):
            text = path.stem.replace("_", " ") if path.suffix in (".png", ".jpg") else path.name
            yield Link(text, f"{quote(name)}/{quote(path.name)}")
