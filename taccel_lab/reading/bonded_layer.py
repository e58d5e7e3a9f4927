# SPDX-License-Identifier: Apache-2.0
"""A gel pad as an elastic layer bonded to its plate: how it sinks under a tool, within a second.

Under a frictionless load the surface of a layer of thickness t sinks, wave by wave, by
``u(k) = G(k) p(k)`` with ``G = 2 (1 - nu^2) / (E k) * (l sinh 2c - 2c) /
(l cosh 2c + 2 c^2 + (1 + l^2) / 2)``, ``c = k t``, ``l = 3 - 4 nu`` (plane strain of a layer that
sticks to a rigid base; K. L. Johnson, Contact Mechanics, 1985, chapters 5.8 and 13). Short waves
see a half-space; long ones hardly sink at all where nu nears 0.5: what goes down comes up beside
it. Where the tool touches, the gel takes its shape and is pressed, elsewhere it is free; that
problem is solved by the conjugate gradients of I. A. Polonsky and L. M. Keer, Wear 231 (1999)
206-219, with Fourier transforms over a grid that is padded by gel at rest. The modulus only scales
the pressure, so it is left out.

Strains are small and there is no friction. Against our own finite elements, balls of 1.5 and 2.92
mm in 4 mm of gel, at equal depth: faces lie within 3 um down to 0.6 mm, at 1.0 mm within 9 um
without friction and 7 um with friction 1, at 1.6 to 1.8 mm within 34 and 15 um, at the equator of
the small ball (1.7 mm) within 90 um; what is off lies beside the contact, in both directions. So no
correction for large strains is made: friction, which nobody knows, moves the face as much. Curved
faces are taken as flat ones with the tool's gap over them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import fft, ifft, irfft, next_fast_len, rfft

from taccel_lab.errors import InputError

PADDING = 1.0
"""Gel at rest on each side of the grid, in thicknesses."""
FAR_MM = 1e3
"""Gap where there is no tool."""
LARGEST_WAVE = 40.0
"""Waves with k t above this are those of a half-space to rounding."""
MAX_ITERATIONS = 200
COARSEST = 64
"""Grids with shorter sides are solved without a coarser one before."""
PART = 16
"""Points; parts of a grid begin and end at a multiple, so that many are of one size."""


@dataclass(frozen=True)
class BondedLayer:
    """What decides how a layer sinks."""

    thickness_mm: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not self.thickness_mm > 0 or not 0 <= self.poisson_ratio < 0.5:
            raise InputError(
                f"a layer has a thickness above 0 mm and a Poisson's ratio in 0..0.5, got "
                f"{self.thickness_mm:g} mm and {self.poisson_ratio:g}"
            )

    def compliance_mm(self, k_per_mm: np.ndarray) -> np.ndarray:
        """Sinking over pressure in waves ``k_per_mm`` [1/mm], times E / (2 (1 - nu^2)) [mm]."""
        ratio = 3.0 - 4.0 * self.poisson_ratio
        c = np.minimum(k_per_mm * self.thickness_mm, LARGEST_WAVE)
        above = ratio * np.sinh(2 * c) - 2 * c
        below = ratio * np.cosh(2 * c) + 2 * c**2 + 0.5 * (1 + ratio**2)
        # Towards k = 0 the quotient is that of the first order in c.
        uniform = 2 * (ratio - 1) * self.thickness_mm / (ratio + 0.5 * (1 + ratio**2))
        return np.divide(above / below, k_per_mm, out=np.full_like(c, uniform), where=k_per_mm > 0)


@dataclass(frozen=True)
class LayerPress:
    """How a layer lies under a tool."""

    rise_mm: np.ndarray
    """Rise of the surface over rest [mm], negative in the dent, shape [h, w]."""
    pressure: np.ndarray
    """Contact pressure times 2 (1 - nu^2) / E, shape [h, w]; above zero where the tool touches."""

    @property
    def contact(self) -> np.ndarray:
        """Where the tool touches, bool, shape [h, w]."""
        return self.pressure > 0


def press_layer(
    tool_mm: np.ndarray,
    depth_mm: float,
    step_mm: tuple[float, float],
    layer: BondedLayer,
    *,
    tolerance: float = 1e-3,
    start: LayerPress | None = None,
) -> LayerPress:
    """Press a tool into the layer.

    Args:
        tool_mm: Underside of the tool over its lowest point [mm], at least 0, shape [h, w];
            ``FAR_MM`` where there is none.
        depth_mm: How deep that point goes below the face at rest.
        step_mm: Distance of the grid's points along x and y.
        layer: The gel.
        tolerance: Largest penetration, and largest gap in the contact, over the depth.
        start: The press at a depth near by, from which a few steps are left.
    """
    if not 0 < depth_mm < layer.thickness_mm:
        raise InputError(
            f"depth {depth_mm:g} mm must lie between 0 and the layer's {layer.thickness_mm:g} mm"
        )
    gap = np.minimum(tool_mm, FAR_MM) - depth_mm
    if (gap >= 0).all():
        raise InputError("the tool does not reach the face; give its height over its lowest point")
    near = None if start is None else start.pressure
    pressure, sunk = pressure_under(gap, step_mm, layer, tolerance * depth_mm, near)
    return LayerPress(-sunk.astype(np.float64), pressure.astype(np.float64))


def press_in_view(
    tool_mm: np.ndarray,
    depth_mm: float,
    step_mm: tuple[float, float],
    layer: BondedLayer,
    tolerance: float,
) -> LayerPress:
    """``press_layer`` in less than half the time, where the tool reaches a part of the grid.

    The grid around the contact is solved first. Its padding ends sooner, which moves the whole
    contact one way by up to the tolerance.
    """
    reached = tool_mm < depth_mm
    if not reached.any():
        reached[:] = True  # ``press_layer`` refuses it.
    lines = [np.flatnonzero(reached.any(axis=axis)) // PART * PART for axis in (1, 0)]
    part = tuple(slice(int(at[0]), int(at[-1]) + PART) for at in lines)
    near = press_layer(tool_mm[part], depth_mm, step_mm, layer, tolerance=tolerance)
    whole = LayerPress(np.zeros(tool_mm.shape), np.zeros(tool_mm.shape))
    whole.pressure[part] = near.pressure
    return press_layer(tool_mm, depth_mm, step_mm, layer, tolerance=tolerance, start=whole)


class _Sinking:
    """Sinking [mm] under a pressure, on a grid of one size or on a part of one."""

    def __init__(
        self,
        shape: tuple[int, ...],
        step_mm: tuple[float, float],
        layer: BondedLayer,
        whole: tuple[int, ...] | None = None,
    ) -> None:
        """``whole``: shape of the grid that ``shape`` is a part of."""
        self.rows, self.columns = shape
        rows, columns = self.padded = _padded(whole or shape, step_mm, layer)
        k_y = 2 * np.pi * np.fft.fftfreq(rows, step_mm[1])
        k_x = 2 * np.pi * np.fft.rfftfreq(columns, step_mm[0])
        compliance = layer.compliance_mm(np.hypot(k_y[:, None], k_x[None, :]))
        if whole is not None:
            # No two points of a part are farther apart than it is long.
            self.padded = tuple(
                min(of_whole, int(next_fast_len(2 * count - 1, real=True) or 0))
                for of_whole, count in zip(self.padded, shape, strict=True)
            )
            kernel = np.fft.irfft2(compliance, (rows, columns))
            for axis, (of_whole, count) in enumerate(
                zip((rows, columns), self.padded, strict=True)
            ):
                if count < of_whole:
                    away = np.arange(count)
                    away = np.where(away < shape[axis], away, away - count)
                    beyond = np.abs(away) >= shape[axis]
                    kernel = np.take(kernel, away, axis=axis)
                    kernel[(slice(None),) * axis + (beyond,)] = 0.0
            compliance = np.fft.rfft2(kernel).real
        self.compliance = compliance.astype(np.float32)

    def __call__(self, pressure: np.ndarray) -> np.ndarray:
        # Axis by axis: rows of padding are nothing before, and nobody asks for them after.
        rows, columns = self.padded
        waves = np.asarray(fft(np.asarray(rfft(pressure, columns, axis=1)), rows, axis=0))
        waves *= self.compliance
        waves = np.asarray(ifft(waves, axis=0, overwrite_x=True))[: self.rows]
        return np.asarray(irfft(waves, columns, axis=1))[:, : self.columns]


def _padded(
    shape: tuple[int, ...], step_mm: tuple[float, float], layer: BondedLayer
) -> tuple[int, ...]:
    """Rows and columns of a grid with gel at rest on each side."""
    return tuple(
        int(next_fast_len(count + int(2 * PADDING * layer.thickness_mm / step), real=True) or 0)
        for count, step in zip(shape, step_mm[::-1], strict=True)
    )


_sinking = lru_cache(maxsize=128)(_Sinking)
"""Sinking on a grid, which frames of one sensor share."""


def pressure_under(
    gap_mm: np.ndarray,
    step_mm: tuple[float, float],
    layer: BondedLayer,
    tolerance_mm: float,
    start: np.ndarray | None = None,
    film_mm: float = 0.0,
    whole: tuple[int, ...] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Contact pressure of a face that may not rise above ``gap_mm``, as of ``LayerPress``, and how
    far the face sinks under it.

    Args:
        gap_mm: Height of the tool over the face at rest [mm], negative below it, shape [h, w];
            ``FAR_MM`` where there is none.
        step_mm: Distance of the grid's points along x and y.
        layer: The gel.
        tolerance_mm: Largest penetration, and largest gap in the contact.
        start: A pressure near the answer, such as the last frame's, shape [h, w].
        film_mm: How far the tool itself gives way under a unit of this pressure.
        whole: Shape of the grid that ``gap_mm`` is a part of, beside which there is no tool.

    Returns:
        Pressure times 2 (1 - nu^2) / E, at least 0, and the sinking [mm], float32, shape [h, w].
    """
    # Single precision is a thousandth of the smallest tolerance, and transforms take half the time.
    gap_mm = gap_mm.astype(np.float32)
    pressure: np.ndarray
    if start is not None:
        pressure = np.where(gap_mm < FAR_MM, start, 0.0).astype(np.float32)
    elif min(gap_mm.shape) >= 2 * COARSEST:
        # A grid of half the points gives a start from which a few steps are left.
        rows, columns = (count - count % 2 for count in gap_mm.shape)
        blocks = gap_mm[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).min(axis=(1, 3))
        double = (2 * step_mm[0], 2 * step_mm[1])
        half = whole and tuple(count // 2 for count in whole)
        coarse, _ = pressure_under(blocks, double, layer, tolerance_mm, film_mm=film_mm, whole=half)
        pressure = np.zeros_like(gap_mm)
        pressure[:rows, :columns] = coarse.repeat(2, axis=0).repeat(2, axis=1)
    else:
        pressure = np.maximum(-gap_mm, 0.0) / layer.thickness_mm
    sinking = _sinking(gap_mm.shape, step_mm, layer, whole)
    direction: np.ndarray = np.zeros_like(pressure)
    before, keep = 1.0, 0.0
    sunk = sinking(pressure)
    # A start of the right shape may be too much or too little, and an end by its last error.
    pressure, sunk = _levelled(pressure, sunk, gap_mm, film_mm)
    for _ in range(MAX_ITERATIONS):
        distance = sunk + film_mm * pressure + gap_mm
        touching = pressure > 0
        left = distance * touching
        if max(left.max(), -distance.min()) < tolerance_mm:
            break
        now = float(np.vdot(left, left))
        kept = keep * now / before if keep else 0.0
        direction = left + kept * (direction * touching) if kept else left
        before = now
        sinks = sinking(direction)
        along = float(np.vdot(sinks + film_mm * direction, direction))
        if not along > 0:
            direction, keep = np.zeros_like(pressure), 0.0
            pressure = np.where(distance < 0, pressure - distance / step_mm[0], pressure)
            sunk = sinking(pressure)
            continue
        length = float(np.vdot(left, direction)) / along
        further = pressure - length * direction
        pressure = np.maximum(further, 0.0)
        # Where the gel would stand in the tool without being pressed it is pressed from now on.
        missed = (pressure == 0) & (distance < 0)
        keep = 0.0 if missed.any() else 1.0
        if not keep:
            pressure = np.where(missed, pressure - length * distance, pressure)
        # As far as pressures change along the direction alone, what sinks under them is known.
        on_line = keep and not further.min() < 0
        sunk = sunk - length * sinks if on_line else sinking(pressure)
    return _levelled(pressure, sunk, gap_mm, film_mm)


def _levelled(
    pressure: np.ndarray, sunk: np.ndarray, gap_mm: np.ndarray, film_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """The multiple of a pressure and of how far the face sinks that misses the tool by nothing on
    average, by pressure."""
    pressed = pressure > 0
    reached = float(np.vdot(pressure, sunk + film_mm * pressure))
    wanted = -float(np.vdot(pressure[pressed], gap_mm[pressed]))
    if not (reached > 0 and wanted > 0):
        return pressure, sunk
    much = np.float32(wanted / reached)
    return much * pressure, much * sunk
