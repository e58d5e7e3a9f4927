# SPDX-License-Identifier: Apache-2.0
"""Nodes along a pad's outline: as many between two anchors everywhere, dense where it is curved.

The chord of an arc of radius R that spans the angle a misses it by R (1 - cos(a / 2)); the spacing
on arcs keeps that below a bound and grows from there along the straight sides.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.cad.parts.pad_outline import PadOutline

MAX_SAGITTA_MM = 0.022
"""How far a chord of the outline may miss its arc [mm]."""
MAX_ROUNDED_SAGITTA_MM = 0.0100
"""The same where the rim is rounded too, so that errors of both directions add up [mm]."""
_GROWTH = 0.8
_SAMPLES = 4096


def outline_anchors(outline: PadOutline) -> np.ndarray:
    """Lengths along the outline [mm] where the corners of an O-grid's core look to, shape [4].

    Counter-clockwise from the quadrant -x, -y. They are the middles of the arcs of about a quarter
    of a turn; a longer arc has two, at the diagonals.
    """
    starts = np.concatenate([[0.0], np.cumsum(outline.piece_lengths_mm)])[:-1:2]
    diagonals = np.pi * (np.arange(4) / 2 - 0.75)
    anchors = []
    for diagonal in diagonals:
        begin = outline.arc_angles[:, 0]
        turn = outline.arc_angles[:, 1] - begin
        offset = (diagonal - begin) % (2 * np.pi)
        k = int(np.argmax(offset < turn))
        middle = turn[k] / 2 if turn[k] < 0.75 * np.pi else offset[k]
        anchors.append(starts[k] + middle * outline.radii_mm[k])
    ahead = np.asarray(anchors)
    return ahead[0] + (ahead - ahead[0]) % outline.perimeter_mm


def arc_cells(radius_mm: float, turn_rad: float, edge_mm: float, sagitta_mm: float) -> float:
    """Cells that an arc needs for a spacing of ``edge_mm`` and the sagitta."""
    step = 2 * np.arccos(max(1 - sagitta_mm / radius_mm, 0.0))
    return turn_rad / min(step, edge_mm / radius_mm, np.pi / 4)


def needed_cells(
    outline: PadOutline, edge_mm: float, sagitta_mm: float = MAX_SAGITTA_MM
) -> np.ndarray:
    """Cells that each quarter between two anchors needs, shape [4]."""
    s, spacing = _spacing_mm(outline, edge_mm, sagitta_mm)
    count = np.concatenate([[0.0], np.cumsum(np.diff(s) / spacing)])
    anchors = outline_anchors(outline)
    ends = np.append(anchors, anchors[0] + outline.perimeter_mm)
    total = count[-1]
    at = np.interp(ends % outline.perimeter_mm, s, count) + total * (ends // outline.perimeter_mm)
    return np.diff(at)


def outline_nodes(
    outline: PadOutline, cells: int, sagitta_mm: float = MAX_SAGITTA_MM
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes on the outline [mm] and outward normals, each shape [4 cells, 2], from anchor 0 on.

    Every quarter between two anchors has ``cells`` cells; its straight parts are stretched until
    they do.
    """
    anchors = outline_anchors(outline)
    ends = np.append(anchors, anchors[0] + outline.perimeter_mm)
    lengths = []
    for k in range(4):
        low, high = 1e-3, outline.perimeter_mm
        for _ in range(60):
            edge = np.sqrt(low * high)
            few = needed_cells(outline, edge, sagitta_mm)[k] < cells
            low, high = (low, edge) if few else (edge, high)
        s, spacing = _spacing_mm(outline, np.sqrt(low * high), sagitta_mm)
        s = np.concatenate([s[:-1], s + outline.perimeter_mm])
        count = np.concatenate([[0.0], np.cumsum(np.diff(s) / np.tile(spacing, 2))])
        first, last = np.interp(ends[k : k + 2] % outline.perimeter_mm, s, count)
        last += count[-1] / 2 if last <= first else 0.0
        wanted = first + (last - first) * np.arange(cells) / cells
        lengths.append(np.interp(wanted, count, s))
    return outline.at_mm(np.concatenate(lengths))


def _spacing_mm(
    outline: PadOutline, edge_mm: float, sagitta_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths along the outline, shape [n + 1], and the spacing of nodes between them [n] [mm]."""
    pieces = outline.piece_lengths_mm
    starts = np.concatenate([[0.0], np.cumsum(pieces)])
    s = np.unique(np.concatenate([np.linspace(0, starts[-1], _SAMPLES + 1), starts]))
    middle = (s[1:] + s[:-1]) / 2
    spacing = np.full(len(middle), edge_mm)
    for k, (begin, end) in enumerate(outline.arc_angles):
        radius = float(outline.radii_mm[k])
        wanted = pieces[2 * k] / arc_cells(radius, end - begin, edge_mm, sagitta_mm)
        center = starts[2 * k] + pieces[2 * k] / 2
        away = np.abs((middle - center + starts[-1] / 2) % starts[-1] - starts[-1] / 2)
        spacing = np.minimum(spacing, wanted + _GROWTH * np.maximum(away - pieces[2 * k] / 2, 0))
    return s, spacing
