# SPDX-License-Identifier: Apache-2.0
"""Pixels as presses show them, to distil a colour model into models with other inputs.

Such a model has no displacement among its inputs, or only colours. What it should answer is the
mean over what occurs in presses, so tilt and displacement are drawn together: from balls of many
sizes pressed to many depths, with the sphere inside the contact and Hertz's surface around it
(Johnson, Contact Mechanics, 1985, eq. 3.42), damped over the gel's thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import rest_surface

BALL_RADII_MM = (1.0, 8.0)
MAX_TILT_DEG = 60.0
"""Where the colour block does not say how steep the surfaces were that it was fitted to."""
TILTS_DEG = (5.0, 80.0)
"""Limits within which the steepest surface that is requested lies."""
SHALLOWEST_MM = -0.02
"""Presses are drawn down to this at least."""
IN_CONTACT = 0.5
"""Share of the samples that comes from inside the contact, where the steep surfaces are."""
REACH = 3.0
"""Contact radii from its middle up to which the others come, evenly over the area."""


@dataclass(frozen=True)
class PressPixels:
    """Samples of presses; all arrays have n rows."""

    pixel_idx: np.ndarray
    """Index of each pixel along rows, shape [n]."""
    slope: np.ndarray
    """Slopes of the height over rest along x and y, shape [n, 2]."""
    displacement_mm: np.ndarray
    """Rise over rest [mm], negative in a dent, shape [n]."""


class ColorSource:
    """The colour model of a profile, asked for single pixels by slope over rest."""

    def __init__(self, profile: SensorProfile) -> None:
        model = ColorModel.from_profile(profile)
        if profile.color is None or model is None:
            raise InputError("the profile has no color block")
        self.model = model
        self.rest = rest_surface(profile.mesh, profile.grid())
        region = profile.color.provenance.valid_region
        self.max_tilt_rad = np.deg2rad(
            np.clip(region.get("surface_tilt_deg", (0.0, MAX_TILT_DEG))[1], *TILTS_DEG)
        )
        """Steepest surface that is requested."""
        deepest_mm = region.get("displacement_mm", (-0.5 * profile.gel.thickness_mm, 0.0))[0]
        self.deepest_mm = min(deepest_mm, SHALLOWEST_MM)
        """Lowest displacement that is requested [mm]."""
        self.thickness_mm = profile.gel.thickness_mm

    def change(
        self, pixel_idx: np.ndarray, slope: np.ndarray, displacement_mm: np.ndarray
    ) -> np.ndarray:
        """Colour change [levels], shape [n, 3], of pixels whose surface has ``slope`` over rest."""
        rest = self.rest.normals.reshape(-1, 3)[pixel_idx]
        pressed = normals_from_slopes(slope - rest[:, :2] / rest[:, 2:])
        return self.model.predict_pixels(pixel_idx, pressed, displacement_mm, rest)

    def profiles(
        self, rng: np.random.Generator, count: int, in_contact: float = IN_CONTACT
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tilt [rad] and displacement [mm] that occur together in ball presses, shape [count]."""
        tilts, displacements = [], []
        have = 0
        while have < count:
            tilt, displacement = _ball_samples(
                rng, 2 * count, np.sin(self.max_tilt_rad), self.thickness_mm, in_contact
            )
            keep = displacement >= self.deepest_mm
            tilts.append(tilt[keep])
            displacements.append(displacement[keep])
            have += int(keep.sum())
        return np.concatenate(tilts)[:count], np.concatenate(displacements)[:count]

    def draw(
        self, rng: np.random.Generator, count: int, in_contact: float = IN_CONTACT
    ) -> PressPixels:
        """Pixels of presses anywhere on the gel, from any side."""
        tilt, displacement = self.profiles(rng, count, in_contact)
        direction = rng.uniform(-np.pi, np.pi, count)
        steep = np.tan(tilt)
        return PressPixels(
            rng.choice(np.flatnonzero(self.rest.covered), count),
            np.stack([steep * np.cos(direction), steep * np.sin(direction)], axis=-1),
            displacement,
        )

    def describe(self) -> str:
        """What was sampled, for the record."""
        low, high = BALL_RADII_MM
        return (
            f"ball presses of {low:g} to {high:g} mm radius, tilts up to "
            f"{np.rad2deg(self.max_tilt_rad):.0f} degrees, displacements down to "
            f"{self.deepest_mm:.2f} mm"
        )


def _ball_samples(
    rng: np.random.Generator,
    count: int,
    steepest: float,
    thickness_mm: float,
    in_contact: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Tilt [rad] and displacement [mm] at points in and around the contacts of balls."""
    smallest, largest = np.log(BALL_RADII_MM)
    ball = np.exp(rng.uniform(smallest, largest, count))
    contact = ball * rng.uniform(0.05, steepest, count)
    inside = rng.uniform(size=count) < in_contact
    area = rng.uniform(size=count)
    r = contact * np.sqrt(np.where(inside, area, 1 + (REACH**2 - 1) * area))
    sine = np.clip(r / ball, 0, steepest)
    # Hertz: the rim of the contact lies a^2 / 2R below the far field.
    rim = contact**2 / (2 * ball)
    cap = -(np.sqrt(ball**2 - r.clip(max=contact) ** 2) - np.sqrt(ball**2 - contact**2)) - rim
    rho = np.maximum(r / contact, 1.0)
    bracket = (2 - rho**2) * np.arcsin(1 / rho) + np.sqrt(rho**2 - 1)
    fade = np.exp(-np.maximum(r - contact, 0) / thickness_mm)
    sink_in = -(contact**2) / (np.pi * ball) * bracket
    slope = 2 * contact / (np.pi * ball) * (rho * np.arcsin(1 / rho) - np.sqrt(1 - 1 / rho**2))
    sink_in_slope = fade * (slope - sink_in / thickness_mm)
    return (
        np.where(inside, np.arcsin(sine), np.arctan(sink_in_slope)),
        np.where(inside, cap, fade * sink_in),
    )
