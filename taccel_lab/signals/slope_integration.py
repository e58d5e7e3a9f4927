# SPDX-License-Identifier: Apache-2.0
"""Height from slopes: the surface whose gradient is nearest to a measured one.

The height minimises the squared difference between its slope along every edge of the pixel grid
and the mean of the two pixels' slopes there. Without weights that is a Poisson equation with
Neumann borders, which the discrete cosine transform solves exactly (Frankot and Chellappa, IEEE
PAMI 10(4), 1988, with the finite-difference eigenvalues of Strang, SIAM Review 41(1), 1999, and
free borders instead of periodic ones). Surfaces of second degree are reproduced to rounding, since
the mean of two slopes is theirs. With weights the same equation is solved by conjugate gradients
with the cosine solution as preconditioner.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

MIN_WEIGHT = 1e-6
"""Weight of a masked pixel: none of its slopes is used, but the surface spans it smoothly."""
RELATIVE_TOLERANCE = 1e-10
MAX_ITERATIONS = 500
PLANE_PRIOR = 0.1
"""Spread of the resting pixels, in half sides of the image, below which they tell no plane."""


def height_from_slopes(
    slope: np.ndarray,
    grid: PixelGrid,
    *,
    weights: np.ndarray | None = None,
    zero: np.ndarray | None = None,
) -> np.ndarray:
    """Height map [m] of measured slopes; scale along rows and columns may differ.

    Args:
        slope: dh/dx and dh/dy, dimensionless, shape [height_px, width_px, 2].
        grid: The pixel grid of the slopes.
        weights: How far each pixel's slope is trusted, 0 to 1, shape [height_px, width_px]; where
            it is 0 the slope may be anything, NaN too, and the surface goes on smoothly.
        zero: Pixels whose mean height is zero, bool, shape [height_px, width_px]; the image's
            border when None.

    Raises:
        InputError: Shapes that differ, slopes that are not finite where they count, no pixel left.
    """
    shape = (grid.height_px, grid.width_px)
    slope = np.array(slope, dtype=np.float64)
    if slope.shape != (*shape, 2):
        raise InputError(f"slopes have shape {slope.shape}, the pixel grid asks for {(*shape, 2)}")
    if weights is not None:
        weights = _checked_weights(weights, shape)
        slope[weights == 0] = 0.0
    if not np.isfinite(slope).all():
        raise InputError("slopes are NaN or infinite; give such pixels the weight 0")
    if zero is None:
        zero = border_of(shape)
    elif zero.shape != shape or not zero.any():
        raise InputError(
            f"zero has shape {zero.shape} with {int(zero.sum())} pixels; {shape} wanted"
        )
    steps = (grid.mm_per_px_x * 1e-3, grid.mm_per_px_y * 1e-3)
    edge_slopes = (
        0.5 * (slope[:, 1:, 0] + slope[:, :-1, 0]),
        0.5 * (slope[1:, :, 1] + slope[:-1, :, 1]),
    )
    if weights is None or (weights == 1.0).all():
        edge_weights = (np.ones_like(edge_slopes[0]), np.ones_like(edge_slopes[1]))
        height = solve_poisson(_divergence(edge_slopes, edge_weights, steps), steps)
    else:
        edge_weights = (
            np.maximum(np.minimum(weights[:, 1:], weights[:, :-1]), MIN_WEIGHT),
            np.maximum(np.minimum(weights[1:], weights[:-1]), MIN_WEIGHT),
        )
        # Beside a masked pixel only the slope of the other one is known; its own was set to 0.
        known = (
            np.minimum(weights[:, 1:], weights[:, :-1]) > 0,
            np.minimum(weights[1:], weights[:-1]) > 0,
        )
        edge_slopes = tuple(np.where(k, s, 0.0) for k, s in zip(known, edge_slopes, strict=True))
        height = _solve_weighted(_divergence(edge_slopes, edge_weights, steps), edge_weights, steps)
    return height - height[zero].mean()


def border_of(shape: tuple[int, int]) -> np.ndarray:
    """Outermost pixels of an image, bool, of this shape."""
    border = np.ones(shape, dtype=bool)
    border[1:-1, 1:-1] = False
    return border


def resting_height(
    slope: np.ndarray,
    grid: PixelGrid,
    *,
    weights: np.ndarray | None = None,
    zero: np.ndarray | None = None,
) -> np.ndarray:
    """``height_from_slopes`` of a surface that lies at rest in the pixels ``zero``: their plane is
    taken off, too."""
    height = height_from_slopes(slope, grid, weights=weights, zero=zero)
    return height - plane_of(height, border_of(height.shape) if zero is None else zero)


def plane_of(height: np.ndarray, zero: np.ndarray) -> np.ndarray:
    """The plane through the heights [m] of the pixels ``zero``, shape [height_px, width_px].

    An error that all slopes share tilts the whole surface; the resting border shows it. Where
    ``zero`` is a narrow part of the image the plane's slopes are drawn to 0 (``PLANE_PRIOR``).
    """
    u, v = (np.linspace(-1.0, 1.0, count) for count in height.shape[::-1])
    rows, columns = np.nonzero(zero)
    place = np.stack([u[columns], v[rows]])
    middle, mean = place.mean(axis=1), float(height[rows, columns].mean())
    away, off = place - middle[:, None], height[rows, columns] - mean
    gram = away @ away.T / len(rows) + PLANE_PRIOR**2 * np.eye(2)
    slope = np.linalg.solve(gram, away @ off / len(rows))
    plane_u, plane_v = slope[0] * (u - middle[0]), slope[1] * (v - middle[1])
    return mean + plane_u[None, :] + plane_v[:, None]


def solve_poisson(right_side: np.ndarray, steps_m: tuple[float, float]) -> np.ndarray:
    """Solve ``laplacian(h) = right_side`` [1/m] with free borders; the mean of h [m] is zero.

    The Laplacian is that of second differences with steps ``steps_m`` along x and y. Shape
    [height_px, width_px]; a mean of the right side, which no surface has, is dropped.
    """
    from scipy.fft import dctn, idctn

    height, width = right_side.shape
    along_x = (2 * np.cos(np.pi * np.arange(width) / width) - 2) / steps_m[0] ** 2
    along_y = (2 * np.cos(np.pi * np.arange(height) / height) - 2) / steps_m[1] ** 2
    eigenvalues = along_y[:, None] + along_x[None, :]
    eigenvalues[0, 0] = 1.0
    spectrum = dctn(right_side, type=2, norm="ortho") / eigenvalues
    spectrum[0, 0] = 0.0
    return np.asarray(idctn(spectrum, type=2, norm="ortho"))


def _checked_weights(weights: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    weights = np.asarray(weights, dtype=np.float64)
    if weights.shape != shape:
        raise InputError(f"weights have shape {weights.shape}, the pixel grid asks for {shape}")
    if not (np.isfinite(weights).all() and weights.min() >= 0.0 and weights.max() <= 1.0):
        raise InputError("weights must lie in 0..1")
    if not (weights > 0).any():
        raise InputError("every weight is 0: no slope is left to integrate")
    return weights


def _divergence(
    edge_values: tuple[np.ndarray, ...],
    edge_weights: tuple[np.ndarray, ...],
    steps_m: tuple[float, float],
) -> np.ndarray:
    """Weighted flow out of every pixel over its edges; nothing leaves through the border."""
    along_x, along_y = (w * v for w, v in zip(edge_weights, edge_values, strict=True))
    out = np.zeros((along_x.shape[0], along_y.shape[1]))
    out[:, :-1] += along_x / steps_m[0]
    out[:, 1:] -= along_x / steps_m[0]
    out[:-1] += along_y / steps_m[1]
    out[1:] -= along_y / steps_m[1]
    return out


def _solve_weighted(
    right_side: np.ndarray, edge_weights: tuple[np.ndarray, ...], steps_m: tuple[float, float]
) -> np.ndarray:
    from scipy.sparse.linalg import LinearOperator, cg

    shape = right_side.shape

    def apply(flat: np.ndarray) -> np.ndarray:
        h = flat.reshape(shape)
        slopes = (np.diff(h, axis=1) / steps_m[0], np.diff(h, axis=0) / steps_m[1])
        return -_divergence(slopes, edge_weights, steps_m).ravel()

    def precondition(flat: np.ndarray) -> np.ndarray:
        return -solve_poisson(flat.reshape(shape), steps_m).ravel()

    size = right_side.size
    solution, failed = cg(
        LinearOperator((size, size), matvec=apply, dtype=np.float64),  # type: ignore[call-arg]
        -right_side.ravel(),
        rtol=RELATIVE_TOLERANCE,
        maxiter=MAX_ITERATIONS,
        M=LinearOperator((size, size), matvec=precondition, dtype=np.float64),  # type: ignore[call-arg]
    )
    if failed:
        raise InputError(
            f"the weighted slopes did not integrate to {RELATIVE_TOLERANCE:g} in {failed} steps; "
            "give weights that differ less, or a mask of 0 and 1"
        )
    return solution.reshape(shape)
