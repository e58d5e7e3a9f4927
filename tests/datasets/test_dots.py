# SPDX-License-Identifier: Apache-2.0
"""Images of a data set show the sensor's dots where its markers are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.datasets.reading import Dataset
from taccel_lab.profile import BackgroundBlock, CameraBlock, ColorBlock, MarkersBlock, save_profile
from taccel_lab.signals.color_model import ColorModelConfig, expected_shapes
from tests.datasets.small import ASSUMED, make, small_profile

WIDTH, HEIGHT, RADIUS_PX = 96, 72, 3.0
LIGHT, DARK = 150, 30


def dotted_profile(folder: Path) -> Path:
    """Colours that no press changes, on a pad with 4 x 3 dots."""
    profile = small_profile()
    view = profile.grid().resized(WIDTH, HEIGHT)
    pitch_mm = 18.0 * view.mm_per_px_x
    markers = MarkersBlock(
        rows=3, columns=4, pitch_x_mm=pitch_mm, pitch_y_mm=pitch_mm,
        radius_mm=RADIUS_PX * view.mm_per_px_x, provenance=ASSUMED,
    )  # fmt: skip
    image = np.full((HEIGHT, WIDTH, 3), LIGHT, np.float32)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    for place in view.pixel_from_gel(markers.grid().points_mm()):
        image[np.hypot(u - place[0], v - place[1]) <= RADIUS_PX] = DARK
    config = ColorModelConfig(WIDTH, HEIGHT, hidden=(8, 8))
    still = {name: np.zeros(shape, np.float32) for name, shape in expected_shapes(config).items()}
    for name in ("perturbation", "color", "background"):
        profile = profile.without(name)
    profile = profile.with_block(CameraBlock.from_grid(view, ASSUMED))
    profile = profile.with_block(BackgroundBlock(provenance=ASSUMED), image)
    profile = profile.with_block(
        ColorBlock(architecture=config.to_dict(), provenance=ASSUMED), still
    )
    save_profile(profile.with_block(markers), folder)
    return folder


def test_dots_go_with_the_markers(tmp_path: Path) -> None:
    profile = dotted_profile(tmp_path / "profile")
    make(
        profile, tmp_path / "out", dataset={"episodes": 1},
        objects=[{"tool": "sphere:3"}],
        motions=[{"kind": "slip", "depth_mm": [0.3, 0.4], "shear_mm": [0.3, 0.4]}],
    )  # fmt: skip
    data = Dataset(tmp_path / "out")
    rgb = data.read("rgb", slice(None)).astype(float)
    markers = data.read("markers_px", slice(None))
    background = data.profile(0).background_rgb
    assert background is not None
    assert np.abs(rgb[0] - background).max() <= 1
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    moved = np.linalg.norm(markers[-1] - markers[0], axis=1)
    assert moved.max() > 0.7
    for step in (0, len(rgb) - 1):
        for u_px, v_px in markers[step]:
            near = np.hypot(u - u_px, v - v_px) < 2 * RADIUS_PX
            dark = (LIGHT - rgb[step, ..., 0])[near]
            middle = [(dark * u[near]).sum() / dark.sum(), (dark * v[near]).sum() / dark.sum()]
            assert np.hypot(*(np.array(middle) - [u_px, v_px])) < 0.25
