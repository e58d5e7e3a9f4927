# SPDX-License-Identifier: Apache-2.0
"""Values as colours: the colour map, its bar with numbers and unit, surfaces painted with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.page_text import PageText
from taccel_lab.viewer.section import SectionSurface

if TYPE_CHECKING:
    from PIL.Image import Image

MAPS = ("viridis", "magma", "turbo", "cividis")
GREY = (0.72, 0.74, 0.77)
"""Of values that are not known."""
_STEPS = 256
_LIT, _GLOW = 0.45, 0.5
"""Part of a colour that depends on the light, and part that does not: shape is seen, and a section
that no light falls on can still be compared with the bar."""


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


def painted(surface: SectionSurface, limits: tuple[float, float], colors: np.ndarray) -> Any:
    """A ``trimesh.Trimesh`` that shows values by a texture of the colour map: between nodes values
    are interpolated, not colours."""
    import trimesh
    from trimesh.visual.material import PBRMaterial
    from trimesh.visual.texture import TextureVisuals

    # Half a texel inside, where neighbours do not mix in.
    u = (shares(surface.values, limits) * (_STEPS - 1) + 0.5) / _STEPS
    uv = np.stack([u, np.full(len(u), 0.5)], axis=1)
    material = PBRMaterial(
        baseColorTexture=_texture(colors), baseColorFactor=(_LIT, _LIT, _LIT, 1.0),
        emissiveTexture=_texture(colors), emissiveFactor=(_GLOW, _GLOW, _GLOW),
        metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True,
    )  # fmt: skip
    return trimesh.Trimesh(
        surface.points, surface.faces, visual=TextureVisuals(uv=uv, material=material),
        process=False, validate=False,
    )  # fmt: skip


def _texture(colors: np.ndarray) -> Image:
    from PIL import Image

    return Image.fromarray(np.repeat(colors[None], 4, axis=0))
