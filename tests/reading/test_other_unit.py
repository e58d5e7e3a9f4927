# SPDX-License-Identifier: Apache-2.0
"""The ± of a starter holds other units than the one that was captured."""

from __future__ import annotations

import numpy as np

import taccel_lab as tl
from taccel_lab.files.images import read_image
from taccel_lab.reading.reading import Reading
from tests.support.real_data import real_data

BESIDE_PX = np.arange(4, 9)
"""Distances from an edge that its faces are read at."""


def angle_between_faces(found: Reading, label: dict[str, np.ndarray]) -> tuple[float, float]:
    """Angle of the faces beside an edge and its standard deviation [degrees]."""
    assert found.sigma_deg is not None
    angle = np.radians(float(label["line_angle"]))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    v, u = np.mgrid[: found.grid.height_px, : found.grid.width_px]
    away = np.stack([u, v], axis=-1) - np.ravel(label["line_center"])
    near = np.abs(away @ along) < 0.3 * float(label["line_length"])
    beside = away @ across
    lean = np.degrees(np.arctan2(found.normals[..., :2] @ across, found.normals[..., 2]))
    # The label is a few pixels off the edge, where the lean changes its sign.
    profile = [lean[near & (np.abs(beside - k) < 0.6)].mean() for k in range(-8, 9)]
    turns = np.flatnonzero((np.array(profile[:-1]) > 0) & (np.array(profile[1:]) <= 0))
    edge = turns[np.argmin(np.abs(turns - 8))] - 7.5
    sides = [near & np.isin(np.rint(side * (beside - edge)), BESIDE_PX) for side in (-1, 1)]
    low, high = (float(lean[side].mean()) for side in sides)
    return low - high, float(np.hypot(*(found.sigma_deg[side].mean() for side in sides)))


def test_edges_of_cubes_lie_within_their_deviation() -> None:
    """Every second of 16 cubes on another GelSight Mini; the others told how far units differ.

    Before, four of eight lay within two standard deviations."""
    folder = real_data("gsmini_cube_edges")
    background = read_image(folder / "background.png")
    reader = tl.Reader(tl.load_sensor("gelsight_mini"), background=background)
    cubes = sorted(path.parent for path in folder.glob("*/gelsight.png"))[1::2]
    off = []
    for cube in cubes:
        found = reader(read_image(cube / "gelsight.png"))
        angle, sigma = angle_between_faces(found, dict(np.load(cube / "label.npz")))
        off.append((angle - 90.0) / sigma)
    assert len(off) == 8
    assert np.max(np.abs(off)) < 2.5 and 0.6 < np.std(off) < 1.4
