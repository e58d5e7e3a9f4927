# SPDX-License-Identifier: Apache-2.0
"""Calibration boards seen through a known lens: exact points, and drawn pictures."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import LENSES, Lens

Pattern = Callable[[np.ndarray], np.ndarray]
"""Reflectance 0..1 at points of the board's plane in pitches, [n, 2] -> [n]."""

WHITE, BLACK = 0.9, 0.08
SIZE = (640, 480)
COLUMNS, ROWS, PITCH = BOARD = 8, 6, 3.0
TRUTHS = {
    "k1": np.array([420, 415, 322, 236, -0.14]),
    "pinhole": np.array([420, 415, 322, 236, -0.28, 0.10, 8e-4, -6e-4, -0.02]),
    "rational": np.array([420, 415, 322, 236, 0.1, 0.05, 8e-4, -6e-4, 0.01, 0.4, 0.1, 0.02]),
    "fisheye": np.array([290, 287, 330, 244, 0.03, -0.01, 0.02, -0.01]),
}
"""Parameters of a lens of every kind, for pictures of ``SIZE``."""


def lattice_points(columns: int, rows: int) -> np.ndarray:
    """Column and row of every point of a board, shape [columns * rows, 2]."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)


def view_of(
    lens: str,
    pose: np.ndarray,
    noise_px: float = 0.0,
    rng: np.random.Generator | None = None,
    name: str = "view",
) -> BoardView:
    """Points of ``BOARD`` where a lens of ``TRUTHS`` puts them; ``pose`` is camera_from_board."""
    index = lattice_points(COLUMNS, ROWS)
    points = np.column_stack([index * PITCH, np.zeros(len(index))])
    uv = LENSES[lens].project(points, TRUTHS[lens], pose)
    if rng is not None:
        uv = uv + rng.normal(0.0, noise_px, uv.shape)
    return BoardView(name, name, SIZE, index, uv, len(index), pitch_mm=PITCH)


def views_of(lens: str, count: int, noise_px: float = 0.0, seed: int = 0) -> list[BoardView]:
    """Views from many sides, all points inside the image."""
    rng, views = np.random.default_rng(seed), []
    while len(views) < count:
        pose = pose_over(
            *BOARD, distance_mm=rng.uniform(24, 40), tilt_deg=tuple(rng.uniform(-35, 35, 2)),
            turn_deg=rng.uniform(-180, 180), shift_mm=tuple(rng.uniform(-8, 8, 2)),
        )  # fmt: skip
        view = view_of(lens, pose, noise_px, rng, f"view{len(views)}")
        if (view.uv_px > 2).all() and (view.uv_px < np.array(SIZE) - 3).all():
            views.append(view)
    return views


def pose_over(
    columns: int,
    rows: int,
    pitch_mm: float,
    *,
    distance_mm: float,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    turn_deg: float = 0.0,
    shift_mm: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """camera_from_board [6] with the board's middle ``distance_mm`` before the camera."""
    tilt = cv2.Rodrigues(np.radians([*tilt_deg, 0.0]))[0]
    rotation = tilt @ cv2.Rodrigues(np.radians([0.0, 0.0, turn_deg]))[0]
    middle = np.array([(columns - 1) / 2 * pitch_mm, (rows - 1) / 2 * pitch_mm, 0.0])
    translation = np.array([*shift_mm, distance_mm]) - rotation @ middle
    return np.concatenate([cv2.Rodrigues(rotation)[0].ravel(), translation])


def chess_pattern(columns: int, rows: int) -> Pattern:
    """A chessboard whose inner corners are at whole numbers from (0, 0)."""

    def pattern(xy: np.ndarray) -> np.ndarray:
        square = np.floor(xy).astype(int)
        inside = (square >= -1).all(axis=1) & (square[:, 0] < columns) & (square[:, 1] < rows)
        dark = inside & (square.sum(axis=1) % 2 == 0)
        return np.where(dark, BLACK, WHITE)

    return pattern


def dot_pattern(
    columns: int, rows: int, radius: float = 0.22, missing: np.ndarray | None = None
) -> Pattern:
    """Dark dots at whole numbers from (0, 0); ``missing`` [n, 2] of them are left out."""
    there = np.ones((columns, rows), dtype=bool)
    there[tuple(np.asarray([] if missing is None else missing, int).reshape(-1, 2).T)] = False

    def pattern(xy: np.ndarray) -> np.ndarray:
        near = np.rint(xy).astype(int)
        inside = (near >= 0).all(axis=1) & (near[:, 0] < columns) & (near[:, 1] < rows)
        inside[inside] = there[tuple(near[inside].T)]
        dark = inside & (np.linalg.norm(xy - near, axis=1) < radius)
        return np.where(dark, BLACK, WHITE)

    return pattern


def render_board(
    lens: Lens,
    parameters: np.ndarray,
    pose: np.ndarray,
    size_px: tuple[int, int],
    pattern: Pattern,
    pitch_mm: float,
    *,
    samples: int = 3,
) -> np.ndarray:
    """Picture of a board on a dark table, levels; pixels are means of ``samples``² sight lines."""
    width, height = size_px
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    rotation = cv2.Rodrigues(np.asarray(pose)[:3])[0]
    # The board's plane is z = 0 in its own frame, where this is the camera's centre.
    center = -rotation.T @ np.asarray(pose)[3:]
    total = np.zeros((height, width))
    for du in steps:
        for dv in steps:
            u, v = np.meshgrid(np.arange(width) + du, np.arange(height) + dv)
            rays = lens.directions(parameters, size_px, np.column_stack([u.ravel(), v.ravel()]))
            along = rays @ rotation
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = -center[2] / along[:, 2]
            hit = np.isfinite(reach) & (reach > 0)
            level = np.full(len(rays), 0.25)
            level[hit] = pattern((center + along[hit] * reach[hit, None])[:, :2] / pitch_mm)
            total += level.reshape(height, width)
    return np.repeat((total / samples**2 * 255.0)[..., None], 3, axis=2)
