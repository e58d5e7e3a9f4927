# SPDX-License-Identifier: Apache-2.0
"""Values as colours: the colour map, its bar with numbers and unit, surfaces painted with it."""

from __future__ import annotations

import io
import json
import struct

import numpy as np

from taccel_lab.report.page_text import PageText
from taccel_lab.viewer.section import SectionSurface

MAPS = ("viridis", "magma", "turbo", "cividis")
GREY = (0.72, 0.74, 0.77)
"""Colour of values that are not known."""
_STEPS = 256
_LIT, _GLOW = 0.45, 0.5
"""Part of a colour that depends on the light, and part that does not: shape is seen, and a section
that no light falls on can still be compared with the bar."""


_UINT, _FLOAT = 5125, 5126
"""Kinds of numbers in glTF."""


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


def painted(surface: SectionSurface, limits: tuple[float, float], colors: np.ndarray) -> bytes:
    """Binary glTF 2.0 that shows values by a texture of the colour map: between nodes values are
    interpolated, not colours.

    Written here: trimesh, which could, takes as long to load as all else of a page.
    """
    # Half a texel inside, where neighbours do not mix in.
    u = (shares(surface.values, limits) * (_STEPS - 1) + 0.5) / _STEPS
    points = np.asarray(surface.points, dtype="<f4")
    parts = (
        np.asarray(surface.faces, dtype="<u4").tobytes(),
        points.tobytes(),
        np.stack([u, np.full(len(u), 0.5)], axis=1).astype("<f4").tobytes(),
        _texture_png(colors),
    )
    binary = b"".join(_padded(part) for part in parts)
    starts = np.cumsum([0, *(len(_padded(part)) for part in parts)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
        for start, part in zip(starts, parts, strict=False)
    ]
    texture = {"index": 0}
    about = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 1, "TEXCOORD_0": 2}, "indices": 0, "material": 0}
        ]}],
        "materials": [{
            "pbrMetallicRoughness": {
                "baseColorTexture": texture, "baseColorFactor": (_LIT, _LIT, _LIT, 1.0),
                "metallicFactor": 0.0, "roughnessFactor": 0.9,
            },
            "emissiveTexture": texture, "emissiveFactor": (_GLOW, _GLOW, _GLOW),
            "doubleSided": True,
        }],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {"bufferView": 0, "componentType": _UINT, "type": "SCALAR",
             "count": surface.faces.size},
            {"bufferView": 1, "componentType": _FLOAT, "type": "VEC3", "count": len(points),
             "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()},
            {"bufferView": 2, "componentType": _FLOAT, "type": "VEC2", "count": len(points)},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    chunks = _chunk(b"JSON", _padded(json.dumps(about).encode(), b" ")) + _chunk(b"BIN\0", binary)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("<I4s", len(data), kind) + data


def _padded(data: bytes, filler: bytes = b"\0") -> bytes:
    """Filled up to whole words, as glTF asks."""
    return data + filler * (-len(data) % 4)


def _texture_png(colors: np.ndarray) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.repeat(colors[None], 4, axis=0)).save(file, "PNG")
    return file.getvalue()
