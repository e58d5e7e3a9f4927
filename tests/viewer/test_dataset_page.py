# SPDX-License-Identifier: Apache-2.0
"""A touch of a data set as it is shown, of arrays that are formulas over oblong pixels."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.viewer.dataset_page import read_touch

WHOLE, KEPT = PixelGrid(48, 30, 0.1, 0.15, center_u_px=20.0), PixelGrid(24, 10, 0.2, 0.45, 9.75)
PATCHES = WHOLE.resized(6, 5)
"""What images were computed in, what is kept of them, and the grid of patches."""


def touch() -> Any:
    """Two steps of a face whose nodes lie in the middles of patches."""
    middles = np.stack(np.meshgrid(PATCHES.x_mm(), PATCHES.y_mm()), axis=-1).reshape(-1, 2)
    nodes = np.column_stack([1e-3 * middles, np.zeros(len(middles))])
    x, y = np.meshgrid(KEPT.x_mm(), KEPT.y_mm())
    forces = np.random.default_rng(0).normal(size=(2, 5, 6, 3))
    arrays = {
        "depth_mm": np.stack([0 * x, 0.5 + 0.01 * x - 0.02 * y]),
        "rgb": np.zeros((2, 10, 24, 3), np.uint8),
        "markers_px": np.tile(WHOLE.pixel_from_gel(middles), (2, 1, 1)),
        "patch_forces_n": forces,
    }
    known = ("step", "depth_mm", "press_force_z_n", "contact_area_mm2")
    unit = {"grid": vars(WHOLE)}
    return SimpleNamespace(
        rows_of=lambda episode: np.array([0, 1]),
        episodes=[{"folder": 0, "episode": 0, "sensor_index": 0, "unit": 0}],
        folders=[SimpleNamespace(root=Path("set"))],
        about=[{"sensors": [{"units": [unit]}]}],
        mesh=lambda episode: (nodes, np.array([[0, 1, 6]])),
        channels=arrays,
        read=lambda name, rows: arrays[name],
        steps={name: np.array([0.0, 1.0]) for name in known} | {"faults": np.array(["", "shift"])},
    )


def test_dots_forces_and_depths_lie_where_the_whole_image_has_them() -> None:
    data = touch()
    found = read_touch(data, 0)
    assert found.images is not None and found.images.markers_px is not None
    wanted = KEPT.pixel_from_gel(found.rest_mm)
    np.testing.assert_allclose(found.images.markers_px[1], wanted, atol=1e-9)
    assert found.captions[1].endswith("contact 1.00 mm², shift")
    assert found.forces_n is not None
    np.testing.assert_allclose(found.forces_n, -data.channels["patch_forces_n"].reshape(2, -1, 3))
    x, y = found.rest_mm[:, 0], found.rest_mm[:, 1]
    # By the nearest pixel.
    off = 0.01 * 0.5 * KEPT.mm_per_px_x + 0.02 * 0.5 * KEPT.mm_per_px_y
    np.testing.assert_allclose(-found.moved_mm[1, :, 2], 0.5 + 0.01 * x - 0.02 * y, atol=off)
