# SPDX-License-Identifier: Apache-2.0
"""What was read from several images as one page: each image beside what it shows, and its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from taccel_lab.report.lead import Link, Picture, Strip
from taccel_lab.report.page import Page, Table
from taccel_lab.report.remark import Remark, Severity

MOST_SHOWN = 24
"""Images that are shown; the table has a line of each."""


def readings_page(
    title: str,
    lines: Mapping[str, Sequence[str]],
    refused: Mapping[str, str],
    folder: Path,
) -> Page:
    """The page of images that were read into ``folder``.

    Args:
        title: What was read.
        lines: By the image's name, what was read, in a line; then what else there is to say.
        refused: Why an image could not be read, by its name.
        folder: Holds ``NAME.png`` and further files of that name.
    """
    shown = list(lines)[:MOST_SHOWN]
    more = len(lines) - len(shown)
    return Page(
        title,
        f"{len(lines)} image{'s' * (len(lines) != 1)} read, {len(refused)} refused."
        + f" The first {len(shown)} are shown." * bool(more),
        [Remark(Severity.WARNING, "refused", why) for why in refused.values()],
        [
            Table(
                "Images",
                ("what was read", "further", "files"),
                [
                    (first, " ".join(text.strip() for text in others), _files(name, folder))
                    for name, (first, *others) in lines.items()
                ],
            )
        ],
        headline=f"{len(lines)} image{'s' * (len(lines) != 1)} read",
        strips=[
            Strip(lines[name][0], [Picture(name, (folder / f"{name}.png").read_bytes, "")])
            for name in shown
        ],
    )


def _files(name: str, folder: Path) -> tuple[Link, ...]:
    found = (folder / f"{name}{suffix}" for suffix in (".png", ".json", ".npz"))
    return tuple(Link(path.suffix[1:], quote(path.name)) for path in found if path.is_file())
