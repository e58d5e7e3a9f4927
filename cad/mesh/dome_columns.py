# SPDX-License-Identifier: Apache-2.0
"""The columns of a dome's mesh: where each node of its plan lies on cap and wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.cad.mesh.columns import check_range, level_fractions
from taccel_lab.cad.mesh.dome_plan import CapGrid, angle_from_disc
from taccel_lab.cad.mesh.structured_topology import plan_quads

EDGE_BOUNDS_MM = (0.2, 6.0)
FOLD_REMEDY = (
    "move the focus away from the edge of the contact face or make it smaller, or use a smaller "
    "edge_mm"
)
_SATURATION = 2.0
"""Tallest layer of a graded column over its mean one."""


@dataclass(frozen=True)
class DomeGrid:
    """Counts that set the connectivity of a dome's plan."""

    cap: CapGrid
    free_rings: int
    """Rings on the free part of the wall."""
    bonded_rings: int
    """Rings on the glued part of the wall."""

    @property
    def rings(self) -> int:
        return self.cap.cap_rings + self.free_rings + self.bonded_rings


@dataclass(frozen=True)
class Columns:
    """The outer ends of the columns, one for each plan node."""

    theta: np.ndarray
    """Polar angle on the cap [rad], the cap's for nodes on the wall."""
    azimuth: np.ndarray
    drop_mm: np.ndarray
    """Distance below the cap's edge along the wall [mm]."""

    def on_sphere_and_wall(self, radius_mm: float, center_z_mm: float) -> np.ndarray:
        """Points on the cap and wall of a radius about (0, 0, center_z_mm) [mm], shape [n, 3]."""
        ring = radius_mm * np.sin(self.theta)
        return np.stack(
            [
                ring * np.cos(self.azimuth),
                ring * np.sin(self.azimuth),
                radius_mm * np.cos(self.theta) + center_z_mm - self.drop_mm,
            ],
            axis=-1,
        )


def dome_columns(
    grid: DomeGrid, disc: np.ndarray, cap_angle: float, drops_mm: np.ndarray
) -> Columns:
    """Columns through the ``disc`` points of the cap and, under its edge, at ``drops_mm`` [rings].

    The last ring of the disc is the cap's edge.
    """
    count = 4 * grid.cap.core
    theta = angle_from_disc(np.abs(disc), cap_angle)
    theta[-count:] = cap_angle
    azimuth = np.angle(disc)
    return Columns(
        theta=np.concatenate([theta, np.full(len(drops_mm) * count, cap_angle)]),
        azimuth=np.concatenate([azimuth, np.tile(azimuth[-count:], len(drops_mm))]),
        drop_mm=np.concatenate([np.zeros(len(disc)), np.repeat(drops_mm, count)]),
    )


def even_drops(height_mm: float, rings: int) -> np.ndarray:
    """Distances below the cap's edge of ``rings`` even rings on a wall [mm]."""
    return height_mm * np.arange(1, rings + 1) / max(rings, 1)


def graded_shares(size_mm: np.ndarray, length_mm: np.ndarray, layers: int) -> np.ndarray:
    """Height of each level as a share of its column, 0 to 1, shape [layers + 1, n].

    The uppermost layer of each column is about as thick as its cell is wide, ``size_mm`` [n]. The
    layers below grow by one factor until they saturate, so that they fill ``length_mm`` [n] without
    a tall one at the end; short columns get even layers.
    """
    powers = np.arange(layers)[:, None]
    tallest = _SATURATION * length_mm / layers

    def thickness(growth: np.ndarray) -> np.ndarray:
        grown = size_mm * growth**powers
        return grown * tallest / (grown + tallest)

    low, high = np.ones(len(size_mm)), np.full(len(size_mm), 8.0)
    for _ in range(50):
        growth = 0.5 * (low + high)
        short = thickness(growth).sum(axis=0) < length_mm
        low, high = np.where(short, growth, low), np.where(short, high, growth)
    below = np.concatenate([np.zeros((1, len(low))), np.cumsum(thickness(low)[::-1], axis=0)])
    shares = below / below[-1]
    shares[-1] = 1.0
    return shares


def focused_sizes(
    grid: DomeGrid,
    outside_mm: np.ndarray,
    away_mm: np.ndarray | None,
    thickness_mm: float,
    layers: int,
    ratio: float,
) -> np.ndarray:
    """Sizes for ``graded_shares`` of a focused mesh with surface points ``outside_mm``, [n, 3]: the
    width of the cells, [n].

    ``away_mm``: how far the cap's nodes, the first of them, lie outside an outline that rings
    follow, or None. Under it the uppermost layer is that of ``layers`` which grow by ``ratio`` over
    the thickness, and goes over to the width as far away as the gel is thick.
    """
    sizes = _cell_widths(outside_mm, plan_quads(grid.cap.core, grid.rings))
    if away_mm is None:
        return sizes
    far = np.ones(len(sizes))
    far[: len(away_mm)] = np.clip(away_mm / thickness_mm, 0, 1)
    uppermost = float(1 - level_fractions(layers, np.array(ratio))[-2])
    return (1 - far) * uppermost * thickness_mm + far * sizes


def _cell_widths(points_mm: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Mean length of the edges at each node of a surface [mm], [n, 3] and [m, 4] -> [n]."""
    total, count = np.zeros(len(points_mm)), np.zeros(len(points_mm))
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)):
        length = np.linalg.norm(points_mm[quads[:, a]] - points_mm[quads[:, b]], axis=1)
        for end in (quads[:, a], quads[:, b]):
            total += np.bincount(end, length, len(total))
            count += np.bincount(end, minlength=len(total))
    return total / count


def check_edge(edge_mm: float, largest_mm: float) -> None:
    """Raise InputError for an element size that no dome can have."""
    low, high = EDGE_BOUNDS_MM
    check_range("edge_mm", edge_mm, low, min(high, largest_mm))
