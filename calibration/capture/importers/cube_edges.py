# SPDX-License-Identifier: Apache-2.0
"""Presses of a cube's edge: ``<n>/gelsight.png`` and ``label.npz`` with the line (a gs_sdk fork)"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import (
    first_existing,
    natural_key,
    number_in,
    point_in,
    sensor_image,
)
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.reading.arrays import read_npz

EDGE_MM = 10.0
DIHEDRAL_DEG = 90.0


def _labels(path: Path) -> list[Path]:
    return sorted(path.glob("*/label.npz"), key=lambda label: natural_key(label.parent.name))


def _recognises(path: Path) -> bool:
    if not path.is_dir() or (path / "catalog.csv").is_file():
        return False
    labels = _labels(path)
    return bool(labels) and "line_center" in read_npz(labels[0])


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "gelsight_mini", path)
    draft.assume("sensor", "gelsight_mini, that of the published set (jonaszilke/gs_sdk)")
    background = first_existing(path / "background.png", path / "background.jpg")
    if background is not None:
        draft.set_background(background, f"{background.name}, by its name")
    elif options.background is None:
        draft.notes.append("no background: background.png is missing; --background gives one")
    length = options.edge_mm
    if length is None:
        length = EDGE_MM
        draft.assume(
            "edge_mm", f"{EDGE_MM:g} mm, that of the published cube; --edge-mm gives another"
        )
    draft.assume("dihedral_deg", f"{DIHEDRAL_DEG:g}, that of a cube")
    edges = []
    for label in _labels(path):
        arrays = read_npz(label)
        draft.used.add(label)
        drawn = label.with_name("labeled.png")
        if drawn.is_file():
            draft.leave_out(drawn, "a drawing of the label")
        u, v = point_in(arrays, "line_center", label)
        edges.append(
            {
                "image": draft.add_image(sensor_image(label.parent), f"edge_{label.parent.name}"),
                "length_mm": float(length),
                "dihedral_deg": DIHEDRAL_DEG,
                "line": {
                    "u_px": u,
                    "v_px": v,
                    "length_px": number_in(arrays, "line_length", label),
                    "angle_deg": number_in(arrays, "line_angle", label),
                },
            }
        )
    draft.manifest["edges"] = edges
    return [draft]


LAYOUT = Layout(
    "cube-edges", "presses of a cube's edge: <n>/gelsight.png with label.npz", _recognises, _read
)
