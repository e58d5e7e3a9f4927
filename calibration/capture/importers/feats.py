# SPDX-License-Identifier: Apache-2.0
"""FEATS (Helmut et al.; MIT): measured force-indentation points, and a homography in px per mm."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.calibration.capture.schema import MAX_MM_PER_PX, MIN_MM_PER_PX
from taccel_lab.errors import InputError
from taccel_lab.reading.arrays import finite_numbers, read_npy
from taccel_lab.reading.cell_number import number
from taccel_lab.reading.json_file import read_json
from taccel_lab.reading.text_file import shown

POINTS = "force_indentation.json"
_RADIUS = re.compile(r"radius\s*([0-9.]+)\s*mm", re.IGNORECASE)


def _recognises(path: Path) -> bool:
    return (path / POINTS).is_file() or (path.is_file() and path.name == POINTS)


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    points = path if path.is_file() else path / POINTS
    draft = Draft("", "gelsight_mini", path)
    draft.assume("sensor", "gelsight_mini, that of the published set (feats-ai/feats)")
    draft.used.add(points)
    values = read_json(points)
    depths = _numbers(points, values, "indentation_mm")
    forces = _numbers(points, values, "normal_force_N")
    if len(depths) != len(forces):
        raise InputError(f"{points}: {len(depths)} indentations, {len(forces)} forces")
    radius = options.radius_mm
    if radius is None:
        match = _RADIUS.search(str(values.get("indenter", "")))
        if match is None:
            raise InputError(f"{points}: the radius of the sphere is not stated; give radius-mm")
        try:
            radius = number(match[1])
        except ValueError as error:
            raise InputError(f"{points}: the radius of the sphere: {error}") from None
    rows = [f"{depth!r},{force!r}" for depth, force in zip(depths, forces, strict=True)]
    draft.files["force_indentation.csv"] = "\n".join(["depth_mm,force_n", *rows]) + "\n"
    tool = {"kind": "sphere", "radius_mm": radius}
    draft.manifest["records"] = [
        {"file": "force_indentation.csv", "kind": "indentation", "tool": tool}
    ]
    homography = first_existing(
        *(points.parent / place / "homography.npy" for place in ("src/feats/homography", "."))
    )
    if homography is not None:
        draft.used.add(homography)
        if options.mm_per_px_x is None:
            _read_scale(homography, draft)
        else:
            draft.leave_out(homography, "--mm-per-px-x replaces its scale")
    return [draft]


def _numbers(path: Path, values: dict[str, Any], key: str) -> list[float]:
    found = values.get(key)
    if not isinstance(found, list) or not all(type(v) in (int, float) for v in found):
        raise InputError(f"{path}: {key} is {shown(found)}; a list of numbers is needed")
    return [float(value) for value in found]


def _read_scale(path: Path, draft: Draft) -> None:
    """Scale from a homography of millimetres to pixels, whose axes may be swapped."""
    matrix = finite_numbers({path.name: read_npy(path)}, path.name, path.parent)
    affine = matrix.shape == (3, 3) and np.abs(matrix[2, :2]).max() <= 1e-9 and matrix[2, 2] != 0
    px_per_mm = np.linalg.norm(matrix[:2, :2] / matrix[2, 2], axis=1) if affine else np.zeros(2)
    if not np.all((px_per_mm >= 1 / MAX_MM_PER_PX) & (px_per_mm <= 1 / MIN_MM_PER_PX)):
        draft.leave_out(path, "no affine 3 x 3 matrix of a scale in px per mm")
        return
    draft.set_scale(float(1 / px_per_mm[0]), float(1 / px_per_mm[1]))
    draft.assume(
        "mm_per_px",
        f"from {path.name}: {px_per_mm[0]:g} x {px_per_mm[1]:g} per mm, taken as pixels of these "
        "images per millimetre",
    )


LAYOUT = Layout("feats", "FEATS: force_indentation.json, homography.npy", _recognises, _read)
