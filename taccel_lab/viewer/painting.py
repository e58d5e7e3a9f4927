# SPDX-License-Identifier: Apache-2.0
"""Values as colours: the colour map, and its bar with numbers and unit."""

from __future__ import annotations

import numpy as np

from taccel_lab.report.page_text import PageText

MAPS = ("viridis", "magma", "turbo", "cividis")
GREY = (0.72, 0.74, 0.77)
"""Colour of values that are not known."""
_STEPS = 256


def map_rgb(name: str) -> np.ndarray:
    """A colour map of matplotlib, uint8 [256, 3]."""
    from matplotlib import colormaps

    return np.round(255 * colormaps[name](np.linspace(0, 1, _STEPS))[:, :3]).astype(np.uint8)


def shares(values: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """Place of values between limits, 0 to 1; those beyond at the ends, NaN at 0."""
    low, high = limits
    return np.nan_to_num(np.clip((values - low) / max(high - low, 1e-30), 0.0, 1.0))


def bar_html(title: str, unit: str, limits: tuple[float, float], colors: np.ndarray) -> PageText:
    """The bar of a colour map: title with unit, five numbers below."""
    stops = PageText(", ").join(f"rgb({r},{g},{b})" for r, g, b in colors[:: _STEPS // 16])
    low, high = limits
    numbers = PageText().join(
        PageText("<span>{}</span>").format(number_text(low + share * (high - low), high - low))
        for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    )
    return PageText(
        '<div style="padding:0.2em 1em 0.4em;font-size:0.8em">'
        "<div><b>{}</b> [{}]</div>"
        '<div style="height:0.9em;border-radius:0.25em;background:linear-gradient(90deg,{})">'
        "</div>"
        '<div style="display:flex;justify-content:space-between;'
        'font-variant-numeric:tabular-nums">{}</div></div>'
    ).format(title, unit, stops, numbers)


def number_text(value: float, span: float) -> str:
    """A number with as many digits as a span asks for."""
    if span <= 0 or not np.isfinite(span):
        return f"{value:.3g}"
    digits = int(np.clip(2 - np.floor(np.log10(span)), 0, 6))
    return f"{value:.{digits}f}"
