# SPDX-License-Identifier: Apache-2.0
"""The published series of a ball on a bonded layer, a referee of the integral equation."""

from __future__ import annotations

import numpy as np


def sphere_force_series_n(
    depth_mm: np.ndarray,
    radius_mm: float,
    thickness_mm: float,
    poisson_ratio: float,
    young_modulus_pa: float = 1.0,
) -> np.ndarray:
    """Force of a ball on a bonded layer [N]: Hertz's formula with a series in chi.

    F = 4/3 E/(1-nu^2) sqrt(R d^3) (1 - 2 a0/pi chi + 4 a0^2/pi^2 chi^2
        - 8/pi^3 (a0^3 + 4 pi^2/15 b0) chi^3 + 16 a0/pi^4 (a0^3 + 3 pi^2/5 b0) chi^4),
    chi = sqrt(R d)/h, a0 = -(1.2876 - 1.4678 nu + 1.3442 nu^2)/(1-nu),
    b0 = (0.6387 - 1.0277 nu + 1.5164 nu^2)/(1-nu).

    E. K. Dimitriadis, F. Horkay, J. Maresca, B. Kachar, R. S. Chadwick: "Determination of elastic
    moduli of thin layers of soft material using the atomic force microscope", Biophysical Journal
    82 (2002), eq. 6 and 13. Valid for chi <= 1 and depths of up to a tenth of the layer; deeper,
    the force is too low by what the strains are no longer small. ``poisson_ratio`` may be 0 to 0.5.
    """
    depth, nu = np.asarray(depth_mm), poisson_ratio
    a0 = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    b0 = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    x = 2 / np.pi * np.sqrt(radius_mm * depth) / thickness_mm
    third, fourth = a0**3 + 4 * np.pi**2 / 15 * b0, a0 * (a0**3 + 3 * np.pi**2 / 5 * b0)
    series = 1 - a0 * x + a0**2 * x**2 - third * x**3 + fourth * x**4
    hertz = 4 / 3 * young_modulus_pa / (1 - nu**2) * np.sqrt(radius_mm * depth**3) * 1e-6
    return hertz * series
