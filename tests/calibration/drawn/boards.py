# SPDX-License-Identifier: Apache-2.0
"""Calibration boards seen through a known lens: exact points, and drawn pictures."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.lens import Lens

Pattern = Callable[[np.ndarray], np.ndarray]
"""Reflectance 0..1 at points of the board's plane in pitches, [n, 2] -> [n]."""

WHITE, BLACK = 0.9, 0.08


def lattice_points(columns: int, rows: int) -> np.ndarray:
    """Column and row of every point of a board, shape [columns * rows, 2]."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)


def exact_view(
    lens: Lens,
    parameters: np.ndarray,
    pose: np.ndarray,
    size_px: tuple[int, int],
    columns: int,
    rows: int,
    pitch_mm: float,
    *,
    noise_px: float = 0.0,
    rng: np.random.Generator | None = None,
    name: str = "view",
) -> BoardView:
    """Points of a board where the lens puts them; ``pose`` is camera_from_board [6]."""
    index = lattice_points(columns, rows)
    points = np.column_stack([index * pitch_mm, np.zeros(len(index))])
    uv = lens.project(points, np.asarray(parameters), np.asarray(pose))
    if noise_px and rng is not None:
        uv = uv + rng.normal(0.0, noise_px, uv.shape)
    return BoardView(name, name, size_px, index, uv, len(index), pitch_mm=pitch_mm)


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
    tilt = cv2.Rodrigues(np.radians([tilt_deg[0], tilt_deg[1], 0.0]))[0]
    turn = cv2.Rodrigues(np.radians([0.0, 0.0, turn_deg]))[0]
    rotation = tilt @ turn
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
    absent = set() if missing is None else {(int(i), int(j)) for i, j in missing}

    def pattern(xy: np.ndarray) -> np.ndarray:
        near = np.rint(xy).astype(int)
        inside = (near >= 0).all(axis=1) & (near[:, 0] < columns) & (near[:, 1] < rows)
        if absent:
            gone = np.zeros((columns, rows), dtype=bool)
            gone[tuple(np.array(sorted(absent)).T)] = True
            inside[inside] &= ~gone[tuple(near[inside].T)]
        dark = inside & (np.linalg.norm(xy - near, axis=1) < radius)
        return np.where(dark, BLACK, WHITE)

    return pattern


def image_pattern(
    image: np.ndarray, px_per_pitch: float, origin_px: tuple[float, float]
) -> Pattern:
    """A drawn board (grey uint8) whose lattice point (0, 0) is at a pixel of the drawing."""

    def pattern(xy: np.ndarray) -> np.ndarray:
        at = (xy * px_per_pitch + np.asarray(origin_px)).astype(np.float32)
        levels = [
            cv2.remap(image, part[:, 0], part[:, 1], cv2.INTER_LINEAR, borderValue=(255.0,)).ravel()
            for part in np.array_split(at, len(at) // 30_000 + 1)
        ]
        return BLACK + (WHITE - BLACK) * np.concatenate(levels) / 255.0

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
    """Picture of a board on a dark table, levels of 255, shape [height_px, width_px, 3].

    Each pixel is the mean of ``samples`` x ``samples`` sight lines.
    """
    width, height = size_px
    steps = (np.arange(samples) + 0.5) / samples - 0.5
    rotation = cv2.Rodrigues(np.asarray(pose)[:3])[0]
    total = np.zeros((height, width))
    for du in steps:
        for dv in steps:
            u, v = np.meshgrid(np.arange(width) + du, np.arange(height) + dv)
            rays = lens.directions(parameters, size_px, np.column_stack([u.ravel(), v.ravel()]))
            # The board's plane z = 0 in its own frame, from the camera's centre there.
            center = -rotation.T @ np.asarray(pose)[3:]
            along = rays @ rotation
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = -center[2] / along[:, 2]
            hit = np.isfinite(reach) & (reach > 0)
            xy = np.zeros((len(rays), 2))
            xy[hit] = (center + along[hit] * reach[hit, None])[:, :2] / pitch_mm
            level = np.full(len(rays), 0.25)
            level[hit] = pattern(xy[hit])
            total += level.reshape(height, width)
    return np.repeat((total / samples**2 * 255.0)[..., None], 3, axis=2)
