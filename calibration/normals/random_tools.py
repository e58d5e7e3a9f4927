# SPDX-License-Identifier: Apache-2.0
"""Undersides of tools drawn at random: what a sensor may be pressed with besides a ball.

Balls and eggs, rollers, wedges, cones, punches with sharp and rounded edges, gratings, knobs, rough
faces and cube corners, one to three side by side, turned and leaning. Sizes are drawn between fine
details and the whole view; ``reach_mm``, half of the view's shorter side, is the unit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from taccel_lab.calibration.circles.bonded_layer import FAR_MM

Tool = Callable[[np.random.Generator, np.ndarray, np.ndarray, float], np.ndarray]
"""(rng, x, y, reach_mm) -> height of the underside [mm], ``FAR_MM`` where there is none."""

LEAN = 0.15
"""Largest slope of a tool that leans; every second one does."""
SIDE_BY_SIDE = (1, 1, 1, 2, 3)


def draw_tool(rng: np.random.Generator, x_mm: np.ndarray, y_mm: np.ndarray) -> np.ndarray:
    """Height of a tool over its lowest point on a grid [mm], shape as ``x_mm`` and ``y_mm``."""
    reach = 0.5 * float(min(np.ptp(x_mm), np.ptp(y_mm)))
    middle = np.array([x_mm.mean(), y_mm.mean()])
    height = np.full(x_mm.shape, FAR_MM)
    for _ in range(rng.choice(SIDE_BY_SIDE)):
        at = middle + rng.uniform(-0.7, 0.7, 2) * reach
        turn = rng.uniform(0.0, 2 * np.pi)
        x, y = x_mm - at[0], y_mm - at[1]
        along = np.cos(turn) * x + np.sin(turn) * y
        across = np.cos(turn) * y - np.sin(turn) * x
        one = TOOLS[int(rng.integers(len(TOOLS)))](rng, along, across, reach)
        lean = rng.uniform(-LEAN, LEAN, 2) * rng.integers(2)
        one = one + lean[0] * along + lean[1] * across
        one += rng.integers(2) * rng.uniform(0.0, 0.05) * reach - one.min()
        height = np.minimum(height, one)
    return np.minimum(height - height.min(), FAR_MM)


def _length(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _round(distance2: np.ndarray, radius: float) -> np.ndarray:
    """A round underside of ``radius`` at squared distances from its lowest point or line."""
    inside = distance2 < radius**2
    return np.where(inside, radius - np.sqrt(np.maximum(radius**2 - distance2, 0.0)), FAR_MM)


def _filleted(outside: np.ndarray, radius: float) -> np.ndarray:
    """A flat underside whose edge is rounded; ``outside`` is the distance from the flat part."""
    wall = _round(outside**2, radius) if radius > 0 else FAR_MM
    return np.where(outside <= 0, 0.0, wall)


def _edge_radius(rng: np.random.Generator, reach: float) -> float:
    """Sharp, broken or round."""
    bounds = ((0.0, 0.0), (0.002, 0.02), (0.005, 0.1))[int(rng.integers(3))]
    return 0.0 if bounds[1] == 0 else _length(rng, *bounds) * reach


def _ball(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    radius = _length(rng, 0.06, 1.3) * reach
    stretch = 1.0 if rng.integers(2) else _length(rng, 1.0, 3.0)
    return _round(x**2 + (y / stretch) ** 2, radius)


def _roller(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    half = 0.5 * _length(rng, 0.2, 2.0) * reach
    return np.where(np.abs(y) < half, _round(x**2, _length(rng, 0.04, 0.9) * reach), FAR_MM)


def _wedge(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Two flanks with a sharp, round or flat edge between them."""
    rise = 1.0 / np.tan(np.radians(rng.uniform(60.0, 160.0)) / 2)
    flat = rng.integers(2) * 0.5 * _length(rng, 0.03, 0.3) * reach
    out = np.maximum(np.abs(x) - flat, 0.0)
    radius = rng.integers(2) * _length(rng, 0.005, 0.05) * reach
    # A circle that goes over into the flank where it is as steep.
    foot = radius * rise / np.hypot(1.0, rise)
    tip = radius - np.sqrt(np.maximum(radius**2 - np.minimum(out, foot) ** 2, 0.0))
    height = tip + rise * np.maximum(out - foot, 0.0)
    return np.where(np.abs(y) < 0.5 * _length(rng, 0.2, 2.0) * reach, height, FAR_MM)


def _cone(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    rise = 1.0 / np.tan(np.radians(rng.uniform(80.0, 165.0)) / 2)
    tip = _length(rng, 0.002, 0.05) * reach
    return np.sqrt(rise**2 * (x**2 + y**2) + tip**2) - tip


def _round_punch(
    rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float
) -> np.ndarray:
    away = np.hypot(x, y) - _length(rng, 0.05, 0.4) * reach
    return _filleted(away, _edge_radius(rng, reach))


def _box(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    half = [_length(rng, 0.05, 0.4) * reach for _ in range(2)]
    away = np.maximum(np.stack([np.abs(x) - half[0], np.abs(y) - half[1]]), 0.0)
    return _filleted(np.hypot(*away), _edge_radius(rng, reach))


def _grating(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    pitch = _length(rng, 0.05, 0.3) * reach
    from_ridge = np.abs((x / pitch + 0.5) % 1 - 0.5) * pitch
    land = from_ridge - 0.5 * rng.uniform(0.3, 0.7) * pitch
    height = np.minimum(
        _filleted(land, _length(rng, 0.03, 0.3) * pitch), _length(rng, 0.2, 1.0) * pitch
    )
    half = 0.5 * _length(rng, 0.3, 1.5) * reach
    return np.where((np.abs(x) < half) & (np.abs(y) < half), height, FAR_MM)


def _knobs(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    pitch = _length(rng, 0.08, 0.3) * reach
    radius = _length(rng, 0.3, 0.6) * pitch
    near = [np.abs((value / pitch + 0.5) % 1 - 0.5) * pitch for value in (x, y)]
    height = np.minimum(_round(near[0] ** 2 + near[1] ** 2, radius), radius)
    half = 0.5 * _length(rng, 0.2, 1.2) * reach
    return np.where((np.abs(x) < half) & (np.abs(y) < half), height, FAR_MM)


def _rough(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Waves of random direction on a gently round face."""
    waves = np.zeros_like(x)
    length = _length(rng, 0.05, 0.4) * reach
    for _ in range(12):
        k = 2 * np.pi / (length * rng.uniform(0.7, 1.5))
        turn, phase = rng.uniform(0.0, 2 * np.pi, 2)
        waves += np.cos(k * (np.cos(turn) * x + np.sin(turn) * y) + phase)
    away2 = x**2 + y**2
    height = away2 / (2 * _length(rng, 0.3, 3.0) * reach)
    height += 0.02 * length * _length(rng, 0.3, 3.0) * waves
    return np.where(away2 < (_length(rng, 0.15, 0.7) * reach) ** 2, height, FAR_MM)


def _corner(rng: np.random.Generator, x: np.ndarray, y: np.ndarray, reach: float) -> np.ndarray:
    """Three faces that meet in a point."""
    turns = np.array([0.0, 2.0, 4.0]) * np.pi / 3 + rng.uniform(-0.4, 0.4, 3)
    rises = rng.uniform(0.3, 1.3, 3)
    return np.max(
        [r * (np.cos(t) * x + np.sin(t) * y) for r, t in zip(rises, turns, strict=True)], axis=0
    )


TOOLS: Sequence[Tool] = (
    _ball, _ball, _roller, _wedge, _wedge, _cone, _round_punch, _round_punch, _box, _box, _box,
    _grating, _grating, _knobs, _rough, _corner,
)  # fmt: skip
"""Sharp edges come more often than they would by kind: they are what is hard to read."""
