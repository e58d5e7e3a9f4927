# SPDX-License-Identifier: Apache-2.0
"""The pad of a DIGIT as formulas: D-shaped outline, rolled-off crown, filleted rim, flat back.

The top is a polynomial of degree six in u = 2 x / width and w = 2 y / length, even in u, fitted to
the gel of facebookresearch/digit-design: rms 0.0055 mm further than 1 mm inside the rim, 0.019 mm
with the fillet over the whole surface. Its mid-section is an arc of 21.4 mm radius. For other radii
the terms in u are scaled by the ratio of the arcs' sags over the half width, for other lengths the
roll-off along y keeps its drops.

The gel frame in millimetres: origin over the centre of the bounding rectangle at the height of the
apex (which lies 2.4 mm nearer to the base and 0.01 mm higher), the finger's tip at +y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import polynomial

from taccel_lab.cad.parameters import parameter
from taccel_lab.cad.parts.height_pad import HeightPad
from taccel_lab.cad.parts.pad_outline import PadOutline, d_shape

_GEL = "measured on the gel of digit-design (facebookresearch, figures only)"
_FIT_RADIUS_MM = 21.4
_FIT_HALF_WIDTH_MM = 9.2
_CENTERLINE_MM = np.array([4.0588, -0.1094, -0.2813, -0.2282, -2.7033, 0.3515, 0.9831])
"""Coefficients of w^0 .. w^6 on the centreline u = 0."""
_SECTION_MM = np.zeros((3, 5))
"""Coefficients of u^2, u^4, u^6 (rows) times w^0 .. w^4 (columns)."""
_SECTION_MM[0] = [-2.0332, 0.3568, 0.1681, -1.3751, 0.8841]
_SECTION_MM[1, :3] = [0.0681, -0.0810, -0.0217]
_SECTION_MM[2, 0] = -0.0944


def _centerline_apex_mm() -> float:
    roots = polynomial.polyroots(polynomial.polyder(_CENTERLINE_MM))
    inside = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < 1)].real
    return float(polynomial.polyval(inside, _CENTERLINE_MM).max())


_APEX_MM = _centerline_apex_mm()


def _sag_mm(radius_mm: float, half_mm: float) -> float:
    return radius_mm - float(np.sqrt(radius_mm**2 - half_mm**2))


def flatter_radius(radius_mm: float, half_mm: float, part: float) -> float:
    """Radius of the arc over a half width that drops by ``part`` of what ``radius_mm`` does; 0, of
    a flat one, stays [mm]."""
    if not radius_mm or part == 1:
        return radius_mm
    sag = part * _sag_mm(radius_mm, half_mm)
    return (half_mm**2 + sag**2) / (2 * sag)


@dataclass(frozen=True)
class DigitPad(HeightPad):
    """Dimensions of a DIGIT's gel [mm]."""

    width_mm: float = parameter(
        18.4, minimum=8, maximum=40, unit="mm", source=f"{_GEL}: 18.4 mm, tip semicircle R 9.2",
        description="gel size along x; the tip is half a circle of this diameter",
    )  # fmt: skip
    length_mm: float = parameter(
        25.0, minimum=10, maximum=60, unit="mm", source=f"{_GEL}: 25.0 mm",
        description="gel size along y, from the base to the tip",
    )  # fmt: skip
    base_corner_mm: float = parameter(
        1.3, minimum=0.3, maximum=10, unit="mm", source=f"{_GEL}: base corners R 1.3",
        description="radius of the outline's corners at the base",
    )  # fmt: skip
    thickness_mm: float = parameter(
        4.07, minimum=0.5, maximum=20, unit="mm", source=f"{_GEL}: 4.07 mm",
        description="gel thickness at the apex",
    )  # fmt: skip
    mid_radius_mm: float = parameter(
        _FIT_RADIUS_MM, minimum=6, maximum=1e5, unit="mm", zero_means="flat",
        source=f"{_GEL}: circular arc, rms 0.001 mm; 21 to 24 along the length",
        description="radius of the cross-section in the middle",
    )  # fmt: skip
    roll_off: float = parameter(
        1.0, minimum=0, maximum=2,
        source=f"{_GEL}: the centreline is flat in the middle and drops to 2.34 mm (base) and 2.65 "
        "mm (tip) above the back",
        description="drop of the centreline towards base and tip, in units of the DIGIT's",
    )  # fmt: skip
    rim_mm: float = parameter(
        0.9, minimum=0.1, maximum=5, unit="mm", source=f"{_GEL}: fillet of about R 0.9",
        zero_means="sharp",
        description="radius of the fillet between contact face and wall",
    )  # fmt: skip
    window_x_mm: float = parameter(
        12.8, minimum=1, maximum=40, unit="mm",
        source="CANFNet calibration: 240 px of 0.0536 mm",
        description="window (the part of the back that the camera sees) along x",
    )  # fmt: skip
    window_y_mm: float = parameter(
        17.1, minimum=1, maximum=60, unit="mm",
        source="CANFNet calibration: 320 px of 0.0536 mm",
        description="window along y",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        half, width = self.width_mm / 2, f"width_mm = {self.width_mm:g}"
        corner, built = self.base_corner_mm, f"with base_corner_mm = {self.base_corner_mm:g}"
        self.require("base_corner_mm", f"does not fit {width}", high=half - 0.05)
        self.require("length_mm", f"is too short for {width}", low=half + corner + 1)
        self.require("rim_mm", f"cannot be built {built}", high=0.9 * corner)
        self.require("mid_radius_mm", f"is too small for {width}", low=1.3 * half)
        self._check_wall()
        self._check_window()

    @cached_property
    def outline(self) -> PadOutline:
        """Outline in plan: half circle at the tip, straight sides, small corners at the base."""
        return d_shape(self.width_mm, self.length_mm, self.base_corner_mm)

    @property
    def has_fillet(self) -> bool:
        return self.rim_mm > 0

    @cached_property
    def _coefficients_mm(self) -> np.ndarray:
        """Coefficients of u^(2 i) w^j, shape [4, 7]; 0 at the apex."""
        found = np.zeros((4, 7))
        found[0] = self.roll_off * _CENTERLINE_MM
        found[0, 0] = self.roll_off * (_CENTERLINE_MM[0] - _APEX_MM)
        if self.mid_radius_mm:
            sag = _sag_mm(self.mid_radius_mm, self.width_mm / 2)
            found[1:, :5] = _SECTION_MM * (sag / _sag_mm(_FIT_RADIUS_MM, _FIT_HALF_WIDTH_MM))
        return found

    @cached_property
    def _slope_coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the derivatives by u^2 and by w."""
        c = self._coefficients_mm
        return polynomial.polyder(c, axis=0), polynomial.polyder(c, axis=1)

    def crown_mm(self, xy_mm: np.ndarray) -> np.ndarray:
        u, w = self._uw(xy_mm)
        return polynomial.polyval2d(u**2, w, self._coefficients_mm)

    def crown_slope(self, xy_mm: np.ndarray) -> np.ndarray:
        u, w = self._uw(xy_mm)
        by_u2, by_w = (polynomial.polyval2d(u**2, w, c) for c in self._slope_coefficients)
        slopes = [by_u2 * 2 * u * 2 / self.width_mm, by_w * 2 / self.length_mm]
        return np.stack(slopes, axis=-1)

    def _uw(self, xy_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        xy = np.asarray(xy_mm, dtype=np.float64)
        return 2 * xy[..., 0] / self.width_mm, 2 * xy[..., 1] / self.length_mm

    def rim_setback_mm(self) -> float:
        return self.rim_mm
