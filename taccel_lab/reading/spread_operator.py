# SPDX-License-Identifier: Apache-2.0
r"""Variance of heights by smooth errors of slopes, a linear function of the slopes' variances.

Errors of slopes are white noise that a Gaussian has made smooth and of unit variance, times the
slopes' standard deviation s. A height is a sum over slopes, ``h(x) = sum_z R(x, z) e(z)``, so that

    Var h(x) = sum_zz' R(x, z) s(z) K(z - z') s(z') R(x, z')

with the noise's correlation K. Where R changes little over the reach of K this is a sum of
``R^2(x, z) t(z)`` with ``t = s (K * s)`` and K of sum 1: a rim that is narrower than errors reach
counts by its width. Next to x, where R changes most, s^2 stands for t. Both sums are matrices from
cells of the image to nodes, made once for a grid of pixels and a reach of errors. R is a product
of rows and columns in the cosines that integrate slopes (``slope_integration``), or, behind a mask,
what a weighted Laplacian gives for each node, row after row of points.

The plane that resting pixels take off is linear in the heights of nodes. How it goes together with
them needs these heights themselves, by unit noise in each cell (``_modes``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.masked_heights import shares_of_slopes
from taccel_lab.reading.slope_integration import PLANE_PRIOR, border_of, inverse_laplacian

if TYPE_CHECKING:
    import torch

POINTS_PER_LENGTH = 2.0
"""Points per reach of errors of the grid that they are integrated on."""
MOST_POINTS = 80
"""Most points along the longer side of that grid."""
NODES = 26
"""Nodes and cells along the longer side: a quarter more change deviations of presses by 1 %."""
NEAR_LENGTHS = 1.5
"""Reach of what is next to a node, in reaches of errors: with it deviations at rims of contacts
agree best with those of many trials."""
FAR_REACHES = 4.0
"""Reaches from a node beyond which nothing is next to it."""
WIDE = 2
"""Cells along each axis of a wide cell: what heights share with a plane is smooth."""
BRIDGE = 1e-2
"""Weight of a point's surroundings, over its own that is missing."""
TINY_WEIGHT = 1e-6


@lru_cache(maxsize=16)
def spread_operator(
    grid: PixelGrid, length_px: float, every: int, device: torch.device, mask: bytes = b""
) -> SpreadOperator:
    """The operator that all readings with these share; ``mask``: packed bits of the pixels that
    count, row by row, or none for all."""
    return SpreadOperator(grid, length_px, every, device, mask)


class SpreadOperator:
    """Variances on one grid of pixels, for one reach of errors.

    Maps are tensors of the operator's device, with images along leading axes: float32 of all
    pixels, float64 of fewer.
    """

    def __init__(
        self, grid: PixelGrid, length_px: float, every: int, device: torch.device, mask: bytes = b""
    ) -> None:
        """
        Args:
            grid: Of the heights.
            length_px: Standard deviation of the Gaussian that errors are smooth over [px].
            every: Rows and columns apart that slopes are given, from the ``every // 2``-th on.
            device: Of torch.
            mask: As of ``spread_operator``.
        """
        import torch

        rows, columns = _axes(grid, length_px)
        trust = None
        if mask:
            bits = np.unpackbits(np.frombuffer(mask, np.uint8), count=rows.count * columns.count)
            seen = bits.reshape(rows.count, columns.count)
            trust = (
                resampling(rows.count, rows.size) @ seen @ resampling(columns.count, columns.size).T
            )
        self._nodes = rows.nodes, columns.nodes

        def maps(of_axis: Callable[[_Axis], np.ndarray], dtype: torch.dtype) -> _ByAxes:
            return _ByAxes(
                *(torch.as_tensor(of_axis(a), dtype=dtype, device=device) for a in (rows, columns))
            )

        few, whole = partial(maps, dtype=torch.float64), partial(maps, dtype=torch.float32)
        self._from_looks = few(lambda a: resampling(len(range(every // 2, a.count, every)), a.size))
        self._correlated = few(lambda a: a.correlation)
        self._cells = few(lambda a: resampling(a.size, a.nodes))
        self._wide_cells = few(lambda a: resampling(a.size, a.wide))
        self._waves, self._flow = few(lambda a: a.waves), few(lambda a: a.waves @ a.flow)
        self._at_nodes, self._at_points = few(lambda a: a.node_waves), few(lambda a: a.unwaved)
        self._nodes_to_points = few(lambda a: a.from_nodes(a.middles))
        self._nodes_to_pixels = whole(lambda a: a.from_nodes(np.arange(a.count)))
        self._pixels_to_nodes = whole(lambda a: a.from_nodes(np.arange(a.count)).T)
        self._points_to_pixels = whole(lambda a: resampling(a.size, a.count))
        self._far, self._near, self._modes = (
            torch.as_tensor(matrix, dtype=torch.float32, device=device)
            for matrix in _matrices(rows, columns, trust)
        )
        self._inverse = torch.as_tensor(_inverse(rows, columns), device=device)
        u, v = (
            torch.linspace(-1, 1, count, dtype=torch.float64, device=device)
            for count in self._nodes[::-1]
        )
        self._place = u.repeat(len(v)), v.repeat_interleave(len(u))
        self._border = self._pixels_to_nodes(border_of((rows.count, columns.count), u).float())

    def at_points(self, looks: torch.Tensor, weights: torch.Tensor | None = None) -> torch.Tensor:
        """Means at points of what is seen at the rows and columns that are given, by weight; where
        nothing counts, of what does next to it."""
        if weights is None:
            return self._from_looks(looks)
        total = self._from_looks(looks.where(weights > 0, 0.0) * weights)
        counted = self._from_looks(weights)
        missing = BRIDGE * (1.0 - counted)
        total, counted = (own + missing * self._correlated(own) for own in (total, counted))
        return total / counted.clamp(min=TINY_WEIGHT)

    def plane(self, zero: torch.Tensor | None) -> Plane:
        """The plane that pixels at rest take off (``slope_integration.plane_of``).

        ``zero``: 1 where a pixel rests, 0 elsewhere; the border does where none is said to.
        """
        import torch

        counted = self._border if zero is None else self._pixels_to_nodes(zero)
        counted = counted.where((counted > 0).flatten(-2).any(-1)[..., None, None], self._border)
        share = counted.flatten(-2).double()
        share /= share.sum(-1, keepdim=True)

        def mean(values: torch.Tensor) -> torch.Tensor:
            return (values * share).sum(-1, keepdim=True)

        across, down = (place - mean(place) for place in self._place)
        uu, vv = (mean(away.square()) + PLANE_PRIOR**2 for away in (across, down))
        uv = mean(across * down)
        by_u, by_v = share * across, share * down
        size = uu * vv - uv.square()
        weights = [share, (vv * by_u - uv * by_v) / size, (uu * by_v - uv * by_u) / size]
        terms = [torch.ones_like(across), across, down]
        return Plane(torch.stack(weights, -2), torch.stack(terms, -1))

    def sigma_m(self, sigma: torch.Tensor, plane: Plane) -> torch.Tensor:
        """Standard deviation of the height of each pixel [m] by that of each component of the
        slope at points."""
        import torch

        even, sharp = sigma * self._correlated(sigma), sigma.square()
        both = self._cells(torch.stack([even, sharp], -3)).flatten(-2).float().mT
        wide = self._wide_cells(even).flatten(-2).float()[..., None, :]
        weights, terms = plane.weights.float(), plane.terms.float()
        by_noise = weights @ self._modes
        shared = (torch.cat([wide, wide], -1) * by_noise).mT
        # Of height less plane: both variances less twice what they share.
        off = terms @ (by_noise @ shared) - 2.0 * (self._modes @ shared)
        # A matrix times a single column would add up otherwise than for many images.
        variance = (self._far @ both)[..., 0] + (self._near @ both)[..., 1] + (terms * off).sum(-1)
        return self._nodes_to_pixels(variance.clamp(min=0.0).sqrt().unflatten(-1, self._nodes))

    def height_m(self, slope: torch.Tensor, plane: Plane) -> torch.Tensor:
        """Height of each pixel [m] over the plane, by slopes along x and y at points, shape
        [2, ..., h, w]."""
        by_x = self._waves.rows @ slope[0] @ self._flow.columns.T
        by_y = self._flow.rows @ slope[1] @ self._waves.columns.T
        waves = self._inverse * (by_x + by_y)
        at_rest = plane.weights @ self._at_nodes(waves).flatten(-2)[..., None]
        level = (plane.terms @ at_rest)[..., 0].unflatten(-1, self._nodes)
        found = self._at_points(waves) - self._nodes_to_points(level)
        return self._points_to_pixels(found.float())


class Plane(NamedTuple):
    """The plane of the pixels at rest: its coefficients by the height of each node, shape
    [..., 3, node], and what they are coefficients of at nodes, shape [..., node, 3]."""

    weights: torch.Tensor
    terms: torch.Tensor


@dataclass(frozen=True)
class _ByAxes:
    """A map from maps to maps: rows by one matrix, columns by another."""

    rows: torch.Tensor
    columns: torch.Tensor

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        return self.rows @ values @ self.columns.T


@dataclass(frozen=True)
class _Axis:
    """Rows, or columns, of pixels (``count``), of points (``size``), of ``nodes``, the outer ones
    on the outer pixels, of as many cells, and noise that is smooth over ``length_px``."""

    count: int
    size: int
    nodes: int
    m_per_px: float
    length_px: float

    @property
    def wide(self) -> int:
        """Wide cells."""
        return -(-self.nodes // WIDE)

    @property
    def step_m(self) -> float:
        """Distance of neighbouring points [m]."""
        return self.m_per_px * self.count / self.size

    @property
    def length(self) -> float:
        """Reach of errors in points."""
        return self.length_px * self.size / self.count

    @property
    def unit(self) -> float:
        """Standard deviation of the smooth noise of pixels that unit noise of points stands for."""
        kept = np.exp(-((np.pi * np.arange(self.count) * self.length_px / self.count) ** 2))
        return float(np.sqrt(kept.mean() * self.count / self.size))

    @property
    def middles(self) -> np.ndarray:
        """Places of points [px]."""
        return (np.arange(self.size) + 0.5) * self.count / self.size - 0.5

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the noise of points, of sum 1, shape [size, size]."""
        return self._smooth(np.sqrt(2.0) * self.length)

    @cached_property
    def waves(self) -> np.ndarray:
        """Cosines of points, shape [wave, size]."""
        return np.cos(
            np.pi / self.size * np.arange(self.size)[:, None] * (np.arange(self.size) + 0.5)
        )

    def _smooth(self, length: float) -> np.ndarray:
        """A Gaussian's average, the noise reflected at the ends, shape [size, size]."""
        kept = np.exp(-0.5 * (np.pi * np.arange(self.size) * length / self.size) ** 2)
        return self.unwaved * kept @ self.waves

    @cached_property
    def noise(self) -> np.ndarray:
        """Smooth noise of points by unit noise of each, shape [size, size]."""
        return self._smooth(self.length) / self.unit

    @property
    def by_noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Waves of a slope's noise, shape [wave, size], and of its divergence along the axis."""
        return self.waves @ self.noise, self.waves @ self.flow @ self.noise

    @property
    def flow(self) -> np.ndarray:
        """Divergence of a slope along the axis [1/m], shape [size, size]: out of a point flow the
        slopes of its edges, means of two points; nothing through the ends."""
        mean = 0.5 * (np.eye(self.size)[:-1] + np.eye(self.size)[1:])
        return np.diff(mean, axis=0, prepend=0, append=0) / self.step_m

    @property
    def unwaved(self) -> np.ndarray:
        """Inverse of ``waves``."""
        return self.waves.T * np.where(np.arange(self.size) == 0, 1.0, 2.0) / self.size

    @property
    def powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean squares of ``by_noise``, summed over points, shape [wave]."""
        angle = np.pi * np.arange(self.size) / self.size
        count = np.where(angle == 0, self.size, 0.5 * self.size)
        even = count * np.exp(-((angle * self.length) ** 2)) / self.unit**2
        return even, even * (np.sin(angle) / self.step_m) ** 2

    @cached_property
    def at_nodes(self) -> np.ndarray:
        """Value at each node by those of points, shape [node, size]."""
        return np.maximum(0.0, 1.0 - np.abs(self._away()))

    @cached_property
    def node_waves(self) -> np.ndarray:
        """Height of each node by waves, shape [node, wave]."""
        return self.at_nodes @ self.unwaved

    @property
    def near(self) -> np.ndarray:
        """How far each point is next to a node, 0 to 1, shape [node, size]."""
        reach = NEAR_LENGTHS * max(self.length, 1.0 / POINTS_PER_LENGTH)
        away = self._away() / reach
        # Numbers that float32 holds by halves take a hundred times as long.
        return np.where(np.abs(away) < FAR_REACHES, np.exp(-0.5 * away**2), 0.0)

    def _away(self) -> np.ndarray:
        at = (np.linspace(0, self.count - 1, self.nodes) + 0.5) * self.size / self.count - 0.5
        return np.clip(at, 0, self.size - 1)[:, None] - np.arange(self.size)

    def from_nodes(self, places_px: np.ndarray) -> np.ndarray:
        """Weights of nodes at places between them, shape [place, node]."""
        step = (self.count - 1) / (self.nodes - 1)
        away = places_px[:, None] / step - np.arange(self.nodes)
        return np.maximum(0.0, 1.0 - np.abs(away))


def _axes(grid: PixelGrid, length_px: float) -> tuple[_Axis, _Axis]:
    """Rows and columns."""
    longer = max(grid.width_px, grid.height_px)
    points = float(min(longer, MOST_POINTS))
    if length_px > 0:
        points = min(points, POINTS_PER_LENGTH * longer / length_px)

    def axis(count: int, mm_per_px: float) -> _Axis:
        size = max(2, round(points * count / longer))
        nodes = min(size, max(2, round(NODES * count / longer)))
        return _Axis(count, size, nodes, 1e-3 * mm_per_px, length_px)

    return axis(grid.height_px, grid.mm_per_px_y), axis(grid.width_px, grid.mm_per_px_x)


def _matrices(
    rows: _Axis, columns: _Axis, trust: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Variance of each node [m2] by t and by s^2 of each cell, shape [node, cell], and its height
    [m] by unit noise of the slope along x, then along y, of each cell, shape [node, 2 cell].
    ``trust``: part of each point that counts; all of it when None."""
    near = rows.near[:, :, None, None] * columns.near
    cells, wide = (
        [
            resampling(a.size, count) * (a.size / count)
            for a, count in zip((rows, columns), counts, strict=True)
        ]
        for counts in ((rows.nodes, columns.nodes), (rows.wide, columns.wide))
    )
    found = []
    for height in _by_waves(rows, columns) if trust is None else _masked(rows, columns, trust):
        square = height**2
        close = square * near.astype(np.float32)
        found.append(
            (
                *(_of_cells(part, *cells) for part in (square - close, close)),
                _of_cells(height, *wide),
            )
        )
    (far_x, near_x, x), (far_y, near_y, y) = found
    far, near = far_x + far_y, near_x + near_y
    # What reaches less far than from point to point is next to a node.
    pixels = _even_variance(*(replace(axis, size=axis.count) for axis in (rows, columns)))
    missed = (pixels / _even_variance(rows, columns) - 1.0) * (far + near).sum(1)
    near *= (1.0 + missed / near.sum(1))[:, None]
    noises = np.sqrt(rows.size * columns.size / (rows.wide * columns.wide))
    return far, near, np.concatenate([x, y], axis=1) / noises


def _by_waves(rows: _Axis, columns: _Axis) -> Iterator[np.ndarray]:
    """Height of each node [m] by unit noise of the slope at each point, along x, then along y,
    float32, shape [node row, point row, node column, point column]."""
    (by_row, out_of_row), (by_column, out_of_column) = rows.by_noise, columns.by_noise
    inverse = _inverse(rows, columns)
    for row, column in ((by_row, out_of_column), (out_of_row, by_column)):
        # Node and point along one axis know nothing of those along the other but by the Laplacian.
        left = (rows.node_waves[:, None] * row.T).reshape(-1, rows.size)
        right = (columns.node_waves[:, None] * column.T).reshape(-1, columns.size)
        height = left.astype(np.float32) @ (inverse @ right.T).astype(np.float32)
        yield height.reshape(rows.nodes, rows.size, columns.nodes, columns.size)


def _masked(rows: _Axis, columns: _Axis, trust: np.ndarray) -> Iterator[np.ndarray]:
    """The same where points count by ``trust`` alone."""
    places = rows.at_nodes[:, None, :, None] * columns.at_nodes[:, None]
    places = places.reshape(-1, rows.size, columns.size)
    for share in shares_of_slopes(places, trust, (columns.step_m, rows.step_m)):
        height = (rows.noise.T @ share @ columns.noise).astype(np.float32)
        height = height.reshape(rows.nodes, columns.nodes, rows.size, columns.size)
        yield np.ascontiguousarray(height.transpose(0, 2, 1, 3))


def _inverse(rows: _Axis, columns: _Axis) -> np.ndarray:
    return inverse_laplacian(rows.size, columns.size, (columns.step_m, rows.step_m))


def _even_variance(rows: _Axis, columns: _Axis) -> np.ndarray:
    """Variance of each node [m2] where slopes have the standard deviation 1 everywhere: a sum over
    waves, which are independent but for the borders."""
    (by_row, out_of_row), (by_column, out_of_column) = rows.powers, columns.powers
    inverse = _inverse(rows, columns)
    waves = inverse**2 * (np.outer(by_row, out_of_column) + np.outer(out_of_row, by_column))
    return (rows.node_waves**2 @ waves @ columns.node_waves.T**2).ravel()


def _of_cells(values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Sums over the points of cells, shape [node, cell], of values of node row, point row, node
    column and point column."""
    by_row = np.tensordot(rows.astype(np.float32), values, (1, 1))
    found = by_row @ columns.T.astype(np.float32)
    nodes = values.shape[0] * values.shape[2]
    return found.transpose(1, 2, 0, 3).reshape(nodes, -1)


@lru_cache(maxsize=64)
def resampling(count: int, wanted: int) -> np.ndarray:
    """Matrix of an axis to fewer or more pixels over the same view, shape [wanted, count]: means
    over larger ones, or linear between the middles of larger ones; rows add up to 1."""
    if wanted >= count:
        at = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
        return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)))
    ends = np.arange(wanted + 1) * count / wanted
    pixels = np.arange(count)
    shared = np.minimum(ends[1:, None], pixels + 1) - np.maximum(ends[:-1, None], pixels)
    return np.maximum(0.0, shared) * wanted / count
