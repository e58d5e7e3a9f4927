# SPDX-License-Identifier: Apache-2.0
"""One look for all figures: light, thin axes, colours that colour-blind readers tell apart."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, ParamSpec, TypeVar

from taccel_lab.files.atomic_file import write_by
from taccel_lab.printable import printable_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito (2008), "Color universal design".
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
PURPLE = "#cc79a7"
CHANNELS = (("red", ORANGE), ("green", GREEN), ("blue", BLUE))
"""Lamps and channels of images, in the colours of their lines."""
GREY = "#6b7280"
LIGHT = "#d1d5db"
INK = "#1f2937"

_DPI = 110
_STYLE: Any = {
    "font.size": 10,
    "axes.titlesize": 10.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "grid.color": "#e5e7eb",
    "text.color": INK,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "image.interpolation": "nearest",
}


P = ParamSpec("P")
R = TypeVar("R")


def in_report_style(draw: Callable[P, R]) -> Callable[P, R]:
    """Run a drawing function under the report's settings, whatever the caller's are."""

    @functools.wraps(draw)
    def styled(*args: P.args, **kwargs: P.kwargs) -> R:
        import matplotlib as mpl

        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return styled


def new_figure(
    width_in: float, height_in: float, rows: int = 1, columns: int = 1, **layout: Any
) -> tuple[Figure, Any]:
    """A figure and its axes (one, or an array), apart from pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **layout)


@in_report_style
def save_figure(figure: Figure, path: Path | str, dpi: int = _DPI) -> None:
    """Write a figure as PNG, whole or not at all, its texts as they are."""
    write_by(path, lambda file: save_figure_to(figure, file, dpi))


def save_drawing(path: Path, draw: Callable[..., Figure], *arguments: Any) -> None:
    """Draw a figure and write it, see ``save_figure``."""
    save_figure(draw(*arguments), path)


@in_report_style
def save_figure_to(figure: Figure, file: BinaryIO, dpi: int = _DPI) -> None:
    """Write a figure as PNG, its texts as they are."""
    _take_as_text(figure)
    with warnings.catch_warnings():
        # Letters of other scripts, for which there is a box where the font has none.
        warnings.filterwarnings("ignore", r"Glyph \d+ ")
        figure.savefig(file, dpi=dpi, format="png", facecolor="white")


def _take_as_text(figure: Figure) -> None:
    """Names of images, profiles and records are anybody's: what stands in them between dollars is
    no formula, and no error of one, and control characters show themselves. Powers of ten at
    logarithmic axes are formulas."""
    from matplotlib.text import Text
    from matplotlib.ticker import LogFormatter

    powers: set[Text] = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if isinstance(axis.get_major_formatter(), LogFormatter):
                powers.update(axis.get_ticklabels(which="both"))
    for text in figure.findobj(Text):
        if isinstance(text, Text) and text not in powers:
            text.set_parse_math(False)
            if not text.get_text().isprintable():
                text.set_text(printable_lines(text.get_text()))
