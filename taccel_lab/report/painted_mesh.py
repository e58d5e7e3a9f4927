# SPDX-License-Identifier: Apache-2.0
"""Surfaces painted with a colour map, for pages that show them in space."""

from __future__ import annotations

import io
import json
import struct
from typing import Any

import numpy as np

_LIT, _GLOW = 0.45, 0.5
"""Part of a colour that depends on the light, and part that does not: shape is seen, and a section
that no light falls on can still be compared with the bar."""
_UINT, _FLOAT = 5125, 5126
"""Kinds of numbers in glTF."""
_SAMPLER = {"wrapS": 33071, "wrapT": 33071, "magFilter": 9729, "minFilter": 9729}
"""Clamped and linear: neither smaller copies of the map nor its other end mix in at an end."""


def painted_mesh(
    points: np.ndarray,
    faces: np.ndarray,
    shares: np.ndarray,
    colors: np.ndarray,
    normals: np.ndarray | None = None,
) -> bytes:
    """Binary glTF 2.0 that shows values by a texture of the colour map: between nodes values are
    interpolated, not colours.

    Written here: trimesh, which could, takes as long to load as all else of a page.

    Args:
        points: [point, 3].
        faces: Triangles, [face, 3].
        shares: Place of each point's value in the map, 0 to 1, [point].
        colors: The map, uint8, [step, 3].
        normals: Of a surface that is smooth, [point, 3]; facets show when None.
    """
    # Half a texel inside, where neighbours do not mix in.
    u = (shares * (len(colors) - 1) + 0.5) / len(colors)
    points = np.asarray(points, dtype="<f4")
    parts = [
        np.asarray(faces, dtype="<u4").tobytes(),
        points.tobytes(),
        np.stack([u, np.full(len(u), 0.5)], axis=1).astype("<f4").tobytes(),
        _texture_png(colors),
    ]
    attributes = {"POSITION": 1, "TEXCOORD_0": 2}
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": _UINT, "type": "SCALAR", "count": faces.size},
        {"bufferView": 1, "componentType": _FLOAT, "type": "VEC3", "count": len(points),
         "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()},
        {"bufferView": 2, "componentType": _FLOAT, "type": "VEC2", "count": len(points)},
    ]  # fmt: skip
    if normals is not None:
        attributes["NORMAL"] = 3
        vectors = {"bufferView": 4, "componentType": _FLOAT, "type": "VEC3", "count": len(points)}
        accessors.append(vectors)
        parts.append(np.asarray(normals, dtype="<f4").tobytes())
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
            {"attributes": attributes, "indices": 0, "material": 0}
        ]}],
        "materials": [{
            "pbrMetallicRoughness": {
                "baseColorTexture": texture, "baseColorFactor": (_LIT, _LIT, _LIT, 1.0),
                "metallicFactor": 0.0, "roughnessFactor": 0.9,
            },
            "emissiveTexture": texture, "emissiveFactor": (_GLOW, _GLOW, _GLOW),
            "doubleSided": True,
        }],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [_SAMPLER],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": accessors,
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
