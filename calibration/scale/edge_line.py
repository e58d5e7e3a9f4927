# SPDX-License-Identifier: Apache-2.0
"""Find the straight edge that is pressed into the gel, and where it ends, without anybody clicking.

An edge between two faces is a line across which the colour jumps: the normals of its faces differ
by the dihedral angle. The line with the most jump along it is taken, and its ends lie where the
jump begins to fall: beyond them the gel comes off the crest and rounds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import exponnorm

from taccel_lab.errors import InputError
from taccel_lab.guards import require_size

MIN_JUMP_LEVELS = 10.0
"""Least jump of colour across the edge [levels of 255]."""
MIN_JUMP_OVER_NOISE = 6.0
MIN_LENGTH_PX = 15.0
_SMOOTH_PX = 1.0
_CANDIDATES = 1500
_NEAR_PX = 1.5
_PARALLEL = 0.9
"""Least cosine between a pixel's gradient and the line's normal."""
_BESIDE_PX = (1.5, 2.5, 3.5)
"""Distances to both sides at which colours are compared."""
_GAP_PX = 6
_TAIL_PX = 12.0
"""The fall of the jump beyond an end is looked at over this length."""
_PLACE_PX = 0.25
"""Standard deviation of an end that a sampled picture cannot do better than."""
_DECAY_SHARE = 0.3
"""How far the law of the fall is trusted: an end is unsure by this share of the decay length."""
_BORDER_PX = 3.0


@dataclass(frozen=True)
class EdgeLine:
    """A pressed edge in the image."""

    ends_px: np.ndarray
    """(u, v) of both ends, shape [2, 2]."""
    length_sigma_px: float
    """Standard deviation of the length, apart from ``systematic_px``."""
    systematic_px: float
    """Standard deviation by the law of the fall beyond the ends, the same for all edges on
    one gel."""

    @property
    def vector_px(self) -> np.ndarray:
        """Vector from one end to the other, shape [2]."""
        return self.ends_px[1] - self.ends_px[0]

    @property
    def length_px(self) -> float:
        return float(np.linalg.norm(self.vector_px))

    @property
    def angle_deg(self) -> float:
        """Angle against the image's rows, from -90 to 90, positive where it falls to the right."""
        u, v = self.vector_px
        return float((np.degrees(np.arctan2(v, u)) + 90.0) % 180.0 - 90.0)


def find_edge(
    image: np.ndarray,
    background: np.ndarray,
    *,
    mask: np.ndarray | None = None,
    name: str = "image",
) -> EdgeLine:
    """The pressed edge in one image.

    Args:
        image: RGB levels, shape [height_px, width_px, 3].
        background: The untouched sensor, of the same size.
        mask: Pixels that may be used, bool, shape [height_px, width_px].

    Raises:
        InputError: No edge, one that runs out of the image, or images of different size.
    """
    require_size(name, image.shape[1::-1], "the background", background.shape[1::-1])
    change = np.asarray(image, dtype=np.float32) - np.asarray(background, dtype=np.float32)
    change -= np.median(change, axis=(0, 1))
    if mask is not None:
        change[~mask] = 0.0
    change = cv2.GaussianBlur(change, (0, 0), _SMOOTH_PX)
    points, strength, normals = _jumps(change, mask)
    noise = float(np.median(strength)) if len(strength) else 0.0
    if len(points) < 20:
        raise InputError(f"{name}: no edge is pressed into the gel; nothing changes sharply")
    point, along = _best_line(points, strength, normals)
    for _ in range(3):
        point, along = _refine(points, strength, normals, point, along)
    positions, jump = _profile(change, point, along)
    start, stop = _longest_run(jump, 0.4 * float(np.quantile(jump, 0.98)))
    level = float(np.median(jump[start:stop]))
    outside = np.concatenate([jump[: max(start - 10, 0)], jump[stop + 10 :]])
    noise = float(np.median(np.abs(outside))) if len(outside) > 10 else noise
    if (
        level < MIN_JUMP_LEVELS
        or level < MIN_JUMP_OVER_NOISE * noise
        or stop - start < MIN_LENGTH_PX
    ):
        raise InputError(
            f"{name}: no edge found; along the sharpest line of {stop - start} px the colour jumps "
            f"by {level:.1f} levels, beside it by {noise:.1f}; at least {MIN_JUMP_LEVELS:g} levels "
            f"over {MIN_LENGTH_PX:g} px and {MIN_JUMP_OVER_NOISE:g} times what is beside it"
        )
    ends, sigmas, decays = [], [], []
    for direction, at in ((-1, start), (1, stop - 1)):
        position, sigma, decay = _end(positions, jump, at, direction, stop - start, name)
        ends.append(point + position * along)
        sigmas.append(sigma)
        decays.append(decay)
    ends_px = np.array(ends)
    size = np.array([image.shape[1] - 1, image.shape[0] - 1])
    if (ends_px < _BORDER_PX).any() or (ends_px > size - _BORDER_PX).any():
        raise InputError(
            f"{name}: the edge runs out of the image (ends at {ends_px.round(0).tolist()} px of "
            f"{size[0] + 1}x{size[1] + 1}); both ends have to be seen"
        )
    return EdgeLine(ends_px, float(np.hypot(*sigmas)), _DECAY_SHARE * sum(decays))


def _jumps(
    change: np.ndarray, mask: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels where the colour changes most sharply [n, 2], how much [n], and the direction [n, 2].

    The direction is the main axis of the colour's structure tensor (S. Di Zenzo, "A note on the
    gradient of a multi-image", CVGIP 33, 1986).
    """
    du = np.stack([cv2.Sobel(change[..., c], cv2.CV_32F, 1, 0, scale=0.125) for c in range(3)])
    dv = np.stack([cv2.Sobel(change[..., c], cv2.CV_32F, 0, 1, scale=0.125) for c in range(3)])
    uu, vv, uv = (du * du).sum(0), (dv * dv).sum(0), (du * dv).sum(0)
    root = np.sqrt((uu - vv) ** 2 + 4 * uv**2)
    strength = np.sqrt(np.maximum((uu + vv + root) / 2, 0.0))
    angle = 0.5 * np.arctan2(2 * uv, uu - vv)
    if mask is not None:
        near = cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
        strength = np.where(near, strength, 0.0)
    strength[:2], strength[-2:], strength[:, :2], strength[:, -2:] = 0, 0, 0, 0
    order = np.argpartition(-strength.ravel(), min(_CANDIDATES, strength.size - 1))[:_CANDIDATES]
    order = order[strength.ravel()[order] > 0]
    v, u = np.unravel_index(order, strength.shape)
    normals = np.column_stack([np.cos(angle[v, u]), np.sin(angle[v, u])])
    return np.column_stack([u, v]).astype(np.float64), strength[v, u].astype(np.float64), normals


def _best_line(
    points: np.ndarray, strength: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Point and direction of the line with the most jump along it: a Hough transform in steps of a
    degree and a pixel, of jumps across the line by their strength."""
    best, most = (points[0], normals[0]), 0.0
    middle = points.mean(axis=0)
    for angle in np.radians(np.arange(180.0)):
        across = np.array([np.cos(angle), np.sin(angle)])
        jumps = np.abs(normals @ across) > _PARALLEL
        if not jumps.any():
            continue
        offset = (points[jumps] - middle) @ across
        low = offset.min()
        by_pixel = np.bincount(np.rint(offset - low).astype(int), strength[jumps])
        total = np.convolve(by_pixel, np.ones(3), "same")
        if total.max() > most:
            most = float(total.max())
            best = middle + (low + int(total.argmax())) * across, across
    point, across = best
    return point, np.array([-across[1], across[0]])


def _refine(
    points: np.ndarray,
    strength: np.ndarray,
    normals: np.ndarray,
    point: np.ndarray,
    along: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Line through the jumps near a line, weighted by their strength."""
    across = np.array([-along[1], along[0]])
    near = np.abs((points - point) @ across) < _NEAR_PX
    close = near & (np.abs(normals @ across) > _PARALLEL)
    if close.sum() < 5:
        return point, along
    weights = strength[close] ** 2
    middle = np.average(points[close], axis=0, weights=weights)
    away = points[close] - middle
    _, vectors = np.linalg.eigh((away * weights[:, None]).T @ away)
    return middle, vectors[:, 1]


def _profile(
    change: np.ndarray, point: np.ndarray, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Jump of the colour across the line [levels] at positions [px] along it, inside the image."""
    height, width = change.shape[:2]
    reach = float(np.hypot(width, height))
    positions = np.arange(-reach, reach, 0.5)
    track = point + positions[:, None] * along
    inside = (track >= 0).all(axis=1) & (track <= (width - 1, height - 1)).all(axis=1)
    positions, track = positions[inside], track[inside]
    across = np.array([-along[1], along[0]])
    total = np.zeros((len(positions), 3))
    for distance in _BESIDE_PX:
        for sign in (1, -1):
            at = (track + sign * distance * across).astype(np.float32)
            total += sign * cv2.remap(
                change, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )[:, 0]  # fmt: skip
    jump = total / len(_BESIDE_PX)
    # The colour of the jump is the same all along: noise across it does not count.
    strongest = jump[np.argsort(-np.linalg.norm(jump, axis=1))[: max(len(jump) // 10, 5)]]
    main = np.linalg.svd(strongest, full_matrices=False)[2][0]
    signed = jump @ main
    return positions, signed * np.sign(np.sum(strongest @ main))


def _longest_run(jump: np.ndarray, least: float) -> tuple[int, int]:
    """First and behind-last sample of the longest stretch above a level, over small gaps."""
    above = np.flatnonzero(jump > least)
    if len(above) == 0:
        return 0, 0
    breaks = np.flatnonzero(np.diff(above) > 2 * _GAP_PX)
    firsts = np.concatenate([[0], breaks + 1])
    lasts = np.concatenate([breaks, [len(above) - 1]])
    k = int(np.argmax(above[lasts] - above[firsts]))
    return int(above[firsts[k]]), int(above[lasts[k]]) + 1


def _end(
    positions: np.ndarray,
    jump: np.ndarray,
    at: int,
    direction: int,
    count: int,
    name: str,
) -> tuple[float, float, float]:
    """Where the edge ends, its standard deviation, and the length of the decay beyond it [px].

    Beyond the end the gel comes off the crest and rounds it, so that the jump does not break off
    but decays exponentially; the end is where it begins to, blurred by our own smoothing (a blur
    measured at the crest placed ends no better on real presses). Samples run outward from inside
    the line.
    """
    inner = max(int(0.1 * count), 12)
    plateau = np.array([at - direction * k for k in range(inner // 2, 3 * inner)])
    plateau = plateau[(plateau >= 0) & (plateau < len(jump))]
    level = float(np.median(jump[plateau]))
    order = np.arange(at - direction * inner, at + direction * int(2 * _TAIL_PX), direction)
    order = order[(order >= 0) & (order < len(jump))]
    values, t = jump[order] / level, np.abs(positions[order] - positions[order[0]])
    below = np.flatnonzero((values[:-1] >= 0.5) & (values[1:] < 0.5))
    if len(below) == 0:
        raise InputError(f"{name}: the edge has no end inside the image; both have to be seen")
    half = float(t[below[0]])
    # What rises again far beyond the end is dirt or another edge.
    used = t < half + _TAIL_PX

    def left(x: np.ndarray) -> np.ndarray:
        end, decay = x[1], x[2] / _SMOOTH_PX
        return x[0] * exponnorm.sf(t[used], decay, end, _SMOOTH_PX) - values[used]

    fit = least_squares(
        left,
        np.array([1.0, half - 0.5, 1.0]),
        bounds=([0.5, half - 12.0, 0.05], [1.5, half + 3.0, 15.0]),
        loss="soft_l1",
        f_scale=0.1,
    )
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * 2 * fit.cost / max(used.sum() - 3, 1)
    # Neighbouring samples are half a pixel apart in a blurred picture: some four say one thing.
    sigma = np.sqrt(4 * covariance[1, 1] + _PLACE_PX**2)
    place = float(positions[order[0]] + direction * fit.x[1])
    return place, float(sigma), float(fit.x[2])
