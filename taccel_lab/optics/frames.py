# SPDX-License-Identifier: Apache-2.0
"""What a render of one frame gives: the light on the gel, what the coating reflects of it (painted
markers, a turbid gel in front) and the 8-bit picture that a camera would deliver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.guards import require_range
from taccel_lab.profile.optical_design import MarkerGrid, lattice_middle, lattice_steps

MARKER_ALBEDO = 0.05
"""Share of the coating's reflectance that is left in the middle of a marker."""
WhiteBalance = Literal["gray", "none"]


@dataclass(frozen=True)
class PreviewImage:
    """A rendered frame; every array has a leading axis of environments when positions had one."""

    rgb: np.ndarray
    """Image as the camera would deliver it, uint8, shape [H, W, 3]."""
    linear: np.ndarray
    """Radiance in relative units, float32, shape [H, W, 3]."""
    mask: np.ndarray
    """Pixels that see the contact face, bool, shape [H, W]."""
    points_mm: np.ndarray
    """Seen points in the gel frame [mm], float32, shape [H, W, 3]; NaN outside the mask."""
    normals: np.ndarray
    """Outward unit normals there, float32, shape [H, W, 3]; NaN outside the mask."""


@dataclass(frozen=True)
class LightField:
    """The light on every pixel of a frame, before the coating's colour."""

    vectors: np.ndarray
    """Irradiance vector of each channel, float32, shape [H, W, 3 channels, 3]; its product with
    the inward normal is the irradiance."""
    specular: np.ndarray
    """Radiance of the glossy lobe, float32, shape [H, W, 3]."""
    facing: np.ndarray
    """Light that comes from the coating's side, all channels, shape [H, W]."""
    blocked: np.ndarray
    """The part of it that the face itself shadows, shape [H, W]."""
    points_mm: np.ndarray
    normals: np.ndarray
    rest_mm: np.ndarray
    """Seen points before the gel deformed [mm], shape [H, W, 3]."""
    mask: np.ndarray

    def irradiance(self) -> np.ndarray:
        """Direct light on the coating by channel, shape [H, W, 3]."""
        return np.maximum(-np.einsum("hwcx,hwx->hwc", self.vectors, self.normals), 0.0)


def marker_factor(grid: MarkerGrid, light: LightField) -> np.ndarray:
    """Factor on the reflectance by painted dots, one pixel soft at the edge, shape [H, W].

    Dots belong to the gel: they are looked up where the seen point was at rest.
    """
    factor = np.ones(light.mask.shape, dtype=np.float32)
    xy = light.rest_mm[light.mask][:, :2] - np.array(grid.offset_mm)
    pitch = np.array([grid.pitch_x_mm, grid.pitch_y_mm])
    middle = lattice_middle(grid.rows, grid.columns, grid.stagger)
    steps = xy @ grid.gel_from_grid() / pitch + middle
    # No dot reaches beyond half the distance of the rows, so that the nearest row holds it.
    row = np.clip(np.rint(steps[:, 1]), 0, grid.rows - 1).astype(int)
    shift = grid.stagger * (row % 2)
    column = np.clip(np.rint(steps[:, 0] - shift), 0, grid.columns - 1).astype(int)
    distance = np.linalg.norm((steps - lattice_steps(row, column, grid.stagger)) * pitch, axis=1)
    distance = np.where(grid.present()[row, column], distance, np.inf)
    cover = np.clip((grid.radius_mm - distance) / _pixel_mm(light) + 0.5, 0.0, 1.0)
    factor[light.mask] = 1 - (1 - MARKER_ALBEDO) * cover
    return factor


def _pixel_mm(light: LightField) -> float:
    """Typical size of a pixel on the face."""
    steps = np.linalg.norm(np.diff(light.rest_mm, axis=1), axis=-1)
    return float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.1


def turbid_reflectance(under: np.ndarray, optical_depth: np.ndarray) -> np.ndarray:
    """Reflectance of a scattering layer without absorption over a coating.

    ``((1 - r) s + r) / ((1 - r) s + 1)`` with the coating's reflectance r and the optical depth s =
    S t (P. Kubelka, F. Munk, "Ein Beitrag zur Optik der Farbanstriche", Z. techn. Physik 12, 1931).
    """
    gain = (1 - under) * optical_depth
    return (gain + under) / (gain + 1)


@dataclass(frozen=True)
class Display:
    """Exposure, white balance and gamma, fixed once for all frames of a sensor."""

    gains: tuple[float, float, float]
    """Factor by channel before gamma; full scale is 1."""
    gamma: float = 2.2

    def levels(self, linear: np.ndarray) -> np.ndarray:
        """Grey levels 0 to 255 before rounding and clipping, [..., 3] -> [..., 3]."""
        scaled = np.maximum(np.asarray(linear) * np.array(self.gains, dtype=np.float32), 0.0)
        return 255.0 * scaled ** (1.0 / self.gamma)

    def rgb(self, linear: np.ndarray) -> np.ndarray:
        """8-bit RGB, [..., 3] -> uint8 [..., 3]."""
        return np.clip(np.rint(self.levels(linear)), 0, 255).astype(np.uint8)

    def levels_per_radiance(self, linear: np.ndarray) -> np.ndarray:
        """Derivative of ``levels``, [..., 3] -> [..., 3]; 0 where there is no light."""
        linear = np.asarray(linear, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self.levels(linear) / (self.gamma * linear)
        return np.where(linear > 0, slope, 0.0)


def exposed(
    linear: np.ndarray,
    mask: np.ndarray,
    *,
    level: float | tuple[float, float, float] = 110.0,
    gamma: float = 2.2,
    white_balance: WhiteBalance = "gray",
) -> Display:
    """Display that gives the background's median a wanted grey level.

    Args:
        linear: Radiance of the untouched gel, shape [H, W, 3].
        mask: Pixels that count, shape [H, W].
        level: Wanted median, 1 to 254, or one for each channel, such as those of a real sensor.
        gamma: Exponent of the camera's response.
        white_balance: gray exposes each channel by itself; none keeps the ratios of the channels
            and exposes the brightest.
    """
    levels = np.broadcast_to(np.asarray(level, dtype=np.float64), (3,))
    require_range("the exposure level", levels.tolist(), 1, 254)
    require_range("gamma", gamma, 0.5, 4)
    if not mask.any():
        raise InputError("no pixel of the camera sees the gel's contact face")
    medians = np.median(linear[mask], axis=0).astype(np.float64)
    if medians.max() <= 0:
        raise InputError("no light reaches the gel that the camera sees")
    common = np.full(3, medians.max())
    # A channel that no light feeds stays dark.
    reference = np.where(medians > 0, medians, common) if white_balance == "gray" else common
    r, g, b = ((levels / 255.0) ** gamma / reference).tolist()
    return Display((r, g, b), gamma)
