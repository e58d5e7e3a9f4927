# SPDX-License-Identifier: Apache-2.0
"""What a page opens with: pictures side by side, figures with what they were scored on, links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.report.mesh_view import MeshView


@dataclass(frozen=True)
class Picture:
    """A figure that is drawn when the page is written, and stored by its name."""

    name: str
    draw: Callable[[], Figure | bytes]
    """The figure, or the PNG or JPEG file that it has become already."""
    caption: str
    view: MeshView | None = None
    """What the reader can turn in its place; print and pages without scripts show the picture."""


@dataclass(frozen=True)
class Link:
    """A way to a page, a picture or a file."""

    text: str
    href: str
    """Relative to the page: the folder can be moved and zipped."""

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True)
class Strip:
    """Pictures of one thing side by side, such as a photo and its simulation."""

    title: str
    panels: Sequence[Picture]
    links: Sequence[Link] = ()


@dataclass(frozen=True)
class Score:
    """A figure that says how good a result is."""

    value: str
    """The number with its uncertainty, or a word where there is none."""
    unit: str
    what: str
    """What it measures, in a few words."""
    scored_on: str
    """What it was taken on, and what it is beside: a baseline, or what is assumed."""
