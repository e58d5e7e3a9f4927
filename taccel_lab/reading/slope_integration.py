# SPDX-License-Identifier: Apache-2.0
"""Height from slopes: the surface whose gradient is nearest to a measured one.

The height minimises the squared difference between its slope along every edge of the pixel grid
and the mean of the two pixels' slopes there. Without weights that is a Poisson equation with
Neumann borders, which the discrete cosine transform solves exactly (Frankot and Chellappa, IEEE
PAMI 10(4), 1988, with the finite-difference eigenvalues of Strang, SIAM Review 41(1), 1999, and
free borders instead of periodic ones). Surfaces of second degree are reproduced to rounding, since
the mean of two slopes is theirs. With weights the same equation is solved by conjugate gradients
with the cosine solution as preconditioner.

Maps may have leading axes, images or trials, that are solved together; tensors stay on their
device.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.room import require, room
from taccel_lab.signals.tensors import Array, as_given, map_totals, tensor_of

if TYPE_CHECKING:
    import torch

MIN_WEIGHT = 1e-6
"""Weight of a masked pixel: none of its slopes is used, but the surface spans it smoothly."""
RELATIVE_TOLERANCE = 1e-7
"""Heights are then off by 2e-6 of the deepest one at most."""
MAX_ITERATIONS = 500
LEAST_ROOM = 8
"""Steps that there is room for at least (``room``)."""
PLANE_PRIOR = 0.1
"""Spread of the resting pixels, in half sides of the image, below which they tell no plane."""
ROWS, COLUMNS = -2, -1
"""Axes of a map."""


def height_from_slopes(
    slope: Array,
    grid: PixelGrid,
    *,
    weights: Any = None,
    zero: Any = None,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Array:
    """Height maps [m] of measured slopes, float64, shape [..., height_px, width_px]; scale along
    rows and columns may differ.

    Args:
        slope: dh/dx and dh/dy, dimensionless, shape [..., height_px, width_px, 2].
        grid: The pixel grid of the slopes.
        weights: How far each pixel's slope is trusted, 0 to 1, shape [height_px, width_px]; where
            it is 0 the slope may be anything, NaN too, and the surface goes on smoothly.
        zero: Pixels whose mean height is zero, bool, shape [..., height_px, width_px]; the image's
            border when None.
        tolerance: Of the equation with weights: its residual over its right side.

    Raises:
        InputError: Shapes that differ, slopes that are not finite where they count, no pixel left.
    """
    height = _of_any_mean(tensor_of(slope), grid, weights, tolerance)
    counted = _counted(zero, height)
    counts = counted.sum(dim=(-2, -1), keepdim=True)
    require(counts > 0, lambda: "zero has no pixel; a mean of some is wanted")
    return as_given(height - map_totals(height * counted) / counts, slope)


def _of_any_mean(
    slopes: torch.Tensor, grid: PixelGrid, weights: Any, tolerance: float
) -> torch.Tensor:
    """Heights [m], float64, of slopes, up to a number for each map; the rest as of
    ``height_from_slopes``."""
    import torch

    shape, steps = (grid.height_px, grid.width_px), _steps_m(grid)
    if slopes.shape[-3:] != (*shape, 2):
        found = tuple(slopes.shape)
        raise InputError(f"slopes have shape {found}, the pixel grid asks for {(*shape, 2)}")
    trust, finite = None, slopes.isfinite()
    if weights is not None:
        trust = _checked_weights(tensor_of(weights, torch.float64, slopes), shape)
        slopes = torch.where(trust[..., None] == 0, 0.0, slopes)
        finite = slopes.isfinite()
    require(finite, lambda: "slopes are NaN or infinite; give such pixels the weight 0")
    if room() is not None and trust is None and slopes.dtype == torch.float32:
        from taccel_lab.reading.fixed_surface import divergence_of

        flow = divergence_of(slopes.reshape(-1, *shape, 2), steps)
        return solve_poisson(flow, steps).reshape(slopes.shape[:-1])
    # In single precision heights of 1 mm are off by 0.3 nm, in half of the time.
    single = trust is None and not slopes.is_cuda
    along_x, along_y = (slopes if single else slopes.double()).unbind(dim=-1)
    return _solved(_on_edges(along_x, along_y), steps, trust, tolerance).double()


def _counted(zero: Any, height: torch.Tensor) -> torch.Tensor:
    """Pixels ``zero`` of heights, bool; their border when None."""
    import torch

    shape = tuple(height.shape[-2:])
    if zero is None:
        return border_of((shape[0], shape[1]), height)
    counted = tensor_of(zero, torch.bool, height)
    if counted.shape[-2:] != shape:
        raise InputError(f"zero has shape {tuple(counted.shape)}; {shape} wanted")
    return counted


def _steps_m(grid: PixelGrid) -> tuple[float, float]:
    return grid.mm_per_px_x * 1e-3, grid.mm_per_px_y * 1e-3


def _on_edges(along_x: torch.Tensor, along_y: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Slopes along the edges between pixels, [..., h, w - 1] and [..., h - 1, w]."""
    return (
        0.5 * (along_x[..., 1:] + along_x[..., :-1]),
        0.5 * (along_y[..., 1:, :] + along_y[..., :-1, :]),
    )


def _solved(
    edges: tuple[torch.Tensor, torch.Tensor],
    steps_m: tuple[float, float],
    trust: torch.Tensor | None,
    tolerance: float,
) -> torch.Tensor:
    """Heights [m] of slopes along edges, of any mean; ``trust``: weights of pixels, [h, w]."""
    import torch

    if trust is None or (room() is None and bool((trust == 1.0).all())):
        return solve_poisson(_divergence(edges, steps_m), steps_m)
    least = (
        torch.minimum(trust[:, 1:], trust[:, :-1]),
        torch.minimum(trust[1:], trust[:-1]),
    )
    edge_weights = tuple(w.clamp(min=MIN_WEIGHT) for w in least)
    # Beside a masked pixel only the slope of the other one is known; its own was set to 0.
    flows = tuple(
        torch.where(low > 0, weight * slope, 0.0)
        for low, weight, slope in zip(least, edge_weights, edges, strict=True)
    )
    return _solve_weighted(_divergence(flows, steps_m), edge_weights, steps_m, tolerance)


def border_of(shape: tuple[int, int], like: torch.Tensor) -> torch.Tensor:
    """Outermost pixels of an image, bool, of this shape, on the device of ``like``."""
    return _border(shape, like.device)


@lru_cache(maxsize=16)
def _border(shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    import torch

    border = torch.ones(shape, dtype=torch.bool)
    border[1:-1, 1:-1] = False
    return border.to(device)


def resting_height(
    slope: Array,
    grid: PixelGrid,
    *,
    weights: Any = None,
    zero: Any = None,
    tolerance: float = RELATIVE_TOLERANCE,
) -> Array:
    """``height_from_slopes`` of a surface that lies at rest in the pixels ``zero``: the plane
    through these is taken off."""
    height = _of_any_mean(tensor_of(slope), grid, weights, tolerance)
    return as_given(height - plane_of(height, _counted(zero, height)), slope)


def plane_of(height: torch.Tensor, zero: torch.Tensor) -> torch.Tensor:
    """The planes through the heights [m] of the pixels ``zero``, shape [..., height_px, width_px].

    An error that all slopes share tilts the whole surface; the resting border shows it. Where
    ``zero`` is a narrow part of the image the plane's slopes are drawn to 0 (``PLANE_PRIOR``).
    """

    rows, columns = height.shape[-2:]
    down, across = (_powers(count, height.dtype, height.device) for count in (rows, columns))
    rests = zero.to(height.dtype)
    rests = rests / rests.sum(dim=(-2, -1), keepdim=True)
    # Means over resting pixels of 1, u, u^2 times 1, v, v^2, and the same times the height.
    place = down.mT @ (rests @ across)
    high = down[:, :2].mT @ ((height * rests) @ across[:, :2])
    u, v, off = place[..., 0, 1], place[..., 1, 0], high[..., 0, 0]
    uu = place[..., 0, 2] - u.square() + PLANE_PRIOR**2
    vv = place[..., 2, 0] - v.square() + PLANE_PRIOR**2
    uv = place[..., 1, 1] - u * v
    by_u, by_v = high[..., 0, 1] - u * off, high[..., 1, 0] - v * off
    size = uu * vv - uv.square()
    right, below = (vv * by_u - uv * by_v) / size, (uu * by_v - uv * by_u) / size
    level = off - right * u - below * v
    along = (level[..., None] + below[..., None] * down[:, 1])[..., None]
    return along + right[..., None, None] * across[:, 1]


@lru_cache(maxsize=32)
def _powers(count: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """1, u and u^2 of the places u of an axis's pixels, -1 to 1, shape [count, 3]."""
    import torch

    place = torch.linspace(-1, 1, count, dtype=dtype, device=device)
    return torch.stack([torch.ones_like(place), place, place.square()], dim=-1)


def solve_poisson(right_side: torch.Tensor, steps_m: tuple[float, float]) -> torch.Tensor:
    """Solve ``laplacian(h) = right_side`` [1/m] with free borders; the mean of h [m] is zero.

    The Laplacian is that of second differences with steps ``steps_m`` along x and y. Shape
    [..., height_px, width_px]; a mean of the right side, which no surface has, is dropped.
    """
    height, width = right_side.shape[-2:]
    inverse = _inverse(height, width, steps_m, right_side.dtype, right_side.device)
    return from_cosines(cosines(right_side) * inverse)


@lru_cache(maxsize=16)
def _inverse(
    height: int, width: int, steps_m: tuple[float, float], dtype: Any, device: torch.device
) -> torch.Tensor:
    return tensor_of(inverse_laplacian(height, width, steps_m)).to(dtype).to(device)


@lru_cache(maxsize=16)
def inverse_laplacian(height: int, width: int, steps_m: tuple[float, float]) -> np.ndarray:
    """Inverse of the Laplacian of cosines, shape [height, width]; 0 for the mean."""
    along_x = (2 * np.cos(np.pi * np.arange(width) / width) - 2) / steps_m[0] ** 2
    along_y = (2 * np.cos(np.pi * np.arange(height) / height) - 2) / steps_m[1] ** 2
    eigenvalues = along_y[:, None] + along_x[None, :]
    eigenvalues[0, 0] = np.inf
    return 1.0 / eigenvalues


def _checked_weights(weights: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    if tuple(weights.shape) != shape:
        raise InputError(
            f"weights have shape {tuple(weights.shape)}, the pixel grid asks for {shape}"
        )
    inside = weights.isfinite() & (weights >= 0.0) & (weights <= 1.0)
    require(inside, lambda: "weights must lie in 0..1")
    require((weights > 0).any(), lambda: "every weight is 0: no slope is left to integrate")
    return weights


def _divergence(flows: tuple[torch.Tensor, ...], steps_m: tuple[float, float]) -> torch.Tensor:
    """Flow out of every pixel over its edges; nothing leaves through the border."""
    along_x, along_y = flows
    out = along_x.new_zeros((*along_x.shape[:-1], along_y.shape[-1]))
    out[..., :-1] += along_x / steps_m[0]
    out[..., 1:] -= along_x / steps_m[0]
    out[..., :-1, :] += along_y / steps_m[1]
    out[..., 1:, :] -= along_y / steps_m[1]
    return out


def _solve_weighted(
    right_side: torch.Tensor,
    edge_weights: tuple[torch.Tensor, ...],
    steps_m: tuple[float, float],
    tolerance: float,
) -> torch.Tensor:
    """Preconditioned conjugate gradients (Hestenes and Stiefel, J. Res. NBS 49(6), 1952), a system
    for each of the leading axes."""

    def apply(h: torch.Tensor) -> torch.Tensor:
        slopes = (h.diff(dim=-1) / steps_m[0], h.diff(dim=-2) / steps_m[1])
        flows = tuple(w * s for w, s in zip(edge_weights, slopes, strict=True))
        return -_divergence(flows, steps_m)

    def ratio(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        # A system that is solved already has nothing left to go along.
        return a / b.where(b > 0, 1.0)

    left = -right_side
    enough = tolerance**2 * map_totals(left * left)
    solution = left.new_zeros(left.shape)
    direction, before = left.new_zeros(left.shape), left.new_zeros(enough.shape)
    failed = (
        f"the weighted slopes did not integrate to {tolerance:g} in {MAX_ITERATIONS} "
        "steps; give weights that differ less, or a mask of 0 and 1"
    )
    here, name = room(), f"steps of {tuple(left.shape)}"
    most = MAX_ITERATIONS if here is None else here.known(name)
    taken = left.new_zeros(())
    for steps in range(MAX_ITERATIONS if most is None else most):
        solved = map_totals(left * left) <= enough
        taken = taken + (~solved).any()
        if here is None or most is None:
            if bool(solved.all()):
                if here is not None:
                    here.needs(name, taken, MAX_ITERATIONS, max(2 * steps, LEAST_ROOM))
                return solution
        conditioned = -solve_poisson(left, steps_m)
        now = map_totals(left * conditioned)
        direction = conditioned + ratio(now, before) * direction
        applied = apply(direction)
        # What is solved stays as it is by itself, however long the others take.
        step = ratio(now, map_totals(direction * applied)).where(~solved, 0.0)
        solution, left, before = solution + step * direction, left - step * applied, now
    if here is None or most is None:
        raise InputError(failed)
    solved = (map_totals(left * left) <= enough).all()
    here.needs(name, taken + ~solved, MAX_ITERATIONS)
    if most == MAX_ITERATIONS:
        require(solved, lambda: failed)
    return solution


# The discrete cosine transform of maps (DCT-II) by a real Fourier transform as long as the axis
# (J. Makhoul, IEEE Trans. ASSP 28(1), 1980).


def cosines(values: torch.Tensor) -> torch.Tensor:
    """sum_ij x_ij cos(pi k (i + 1/2) / h) cos(pi l (j + 1/2) / w), shape [..., h, w]."""
    if values.is_cuda:
        rows, columns = (_waves(count, values.device)[0] for count in values.shape[-2:])
        return rows @ (values @ columns.T)
    return _forward(_forward(values, COLUMNS), ROWS)


def from_cosines(values: torch.Tensor) -> torch.Tensor:
    """Inverse of ``cosines``, shape [..., h, w]."""
    if values.is_cuda:
        rows, columns = (_waves(count, values.device)[1] for count in values.shape[-2:])
        return rows @ (values @ columns.T)
    return _backward(_backward(values, ROWS), COLUMNS)


@lru_cache(maxsize=32)
def _waves(count: int, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Cosines of an axis, shape [wave, place], and their inverse: a GPU takes two products of
    matrices in half the time of its transforms with all that they need before and after."""
    import torch

    at = torch.arange(count, dtype=torch.float64)
    waves = (torch.pi / count * at[:, None] * (at + 0.5)).cos()
    share = torch.where(at == 0, 1.0, 2.0) / count
    return waves.to(device), (waves.T * share).contiguous().to(device)


@lru_cache(maxsize=32)
def _turns(count: int, axis: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """exp(-i pi k / 2n) for k of a half of the spectrum along an axis; ``dtype``: of its parts."""
    import torch

    k = torch.arange(count // 2 + 1, dtype=dtype, device=device)
    turns = torch.polar(torch.ones_like(k), k * (-torch.pi / (2 * count)))
    return turns[:, None] if axis == ROWS else turns


@lru_cache(maxsize=32)
def _mixed(count: int, device: torch.device) -> torch.Tensor:
    """Places of even number, then those of odd number from the last one on."""
    import torch

    places = torch.arange(count, device=device)
    return torch.cat([places[::2], places[1::2].flip(0)])


@lru_cache(maxsize=32)
def _unmixed(count: int, device: torch.device) -> torch.Tensor:
    return _mixed(count, device).argsort()


def _forward(x: torch.Tensor, axis: int) -> torch.Tensor:
    import torch

    count = x.shape[axis]
    mixed = x.index_select(axis, _mixed(count, x.device))
    turned = torch.fft.rfft(mixed, dim=axis) * _turns(count, axis, x.dtype, x.device)
    rest = turned.imag.narrow(axis, 1, (count - 1) // 2).flip(axis)
    return torch.cat([turned.real, rest.neg_()], dim=axis)


def _backward(x: torch.Tensor, axis: int) -> torch.Tensor:
    import torch

    count = x.shape[axis]
    half = count // 2
    imaginary = x.narrow(axis, count - half, half).flip(axis).neg_()
    imaginary = torch.cat([torch.zeros_like(x.narrow(axis, 0, 1)), imaginary], dim=axis)
    spectrum = torch.complex(x.narrow(axis, 0, half + 1).contiguous(), imaginary)
    spectrum *= _turns(count, axis, x.dtype, x.device).conj()
    mixed = torch.fft.irfft(spectrum, n=count, dim=axis)
    return mixed.index_select(axis, _unmixed(count, x.device))
