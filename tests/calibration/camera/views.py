# SPDX-License-Identifier: Apache-2.0
"""Exact views of a board through a known lens, for round trips."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import BoardCaptures
from taccel_lab.calibration.capture.schema import BoardEntry
from tests.calibration.drawn.boards import exact_view, pose_over

SIZE = (640, 480)
TRUTHS = {
    "k1": np.array([420.0, 415.0, 322.0, 236.0, -0.14]),
    "pinhole": np.array([420.0, 415.0, 322.0, 236.0, -0.28, 0.10, 8e-4, -6e-4, -0.02]),
    "rational": np.array(
        [420.0, 415.0, 322.0, 236.0, 0.1, 0.05, 8e-4, -6e-4, 0.01, 0.4, 0.1, 0.02]
    ),
    "fisheye": np.array([290.0, 287.0, 330.0, 244.0, 0.03, -0.01, 0.02, -0.01]),
}
COLUMNS, ROWS, PITCH = 8, 6, 3.0


def views_of(name: str, count: int = 16, noise_px: float = 0.0, seed: int = 0) -> list[BoardView]:
    """Views from many sides, all points inside the image."""
    rng = np.random.default_rng(seed)
    lens, truth, views = LENSES[name], TRUTHS[name], []
    while len(views) < count:
        pose = pose_over(
            COLUMNS, ROWS, PITCH,
            distance_mm=rng.uniform(24, 40), tilt_deg=tuple(rng.uniform(-35, 35, 2)),
            turn_deg=rng.uniform(-180, 180), shift_mm=tuple(rng.uniform(-8, 8, 2)),
        )  # fmt: skip
        view = exact_view(
            lens, truth, pose, SIZE, COLUMNS, ROWS, PITCH,
            noise_px=noise_px, rng=rng, name=f"view{len(views)}",
        )  # fmt: skip
        if (view.uv_px > 2).all() and (view.uv_px < np.array(SIZE) - 3).all():
            views.append(view)
    return views


def board_of(images: list[np.ndarray], columns: int, rows: int) -> BoardCaptures:
    """A chessboard in some images, as a capture folder has it."""
    names = [f"v{k}.png" for k in range(len(images))]
    entry = BoardEntry(kind="chessboard", columns=columns, rows=rows, images=names)
    frames = tuple(
        Frame(name, name, sha256(image.tobytes()).hexdigest(), lambda image=image: image)
        for name, image in zip(names, images, strict=True)
    )
    return BoardCaptures(entry, frames, None)
