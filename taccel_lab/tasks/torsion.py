# SPDX-License-Identifier: Apache-2.0
"""Closed forms: a rigid ball, pressed on an elastic half-space and turned about the normal.

Pressure is Hertz's; turning does not change it. Where friction would not hold, the rim of the
contact slips and a disc of radius c sticks [Lubkin 1951, J. Appl. Mech. 18:183; Johnson 1985,
Contact Mechanics, 7.4]. With the transform of torsion [Sneddon 1966, Mixed boundary value problems]

    u(r) = 1 / r int_0^min(r, a) t g(t) / sqrt(r^2 - t^2) dt,    torque = 4 pi G int_0^a t g(t) dt,

turning the disc gives g = 4 theta t / pi for t < c, and slip of traction q(r) on r > c gives
g = 2 t / (pi G) int_t^a q(r) / sqrt(r^2 - t^2) dr = (2 t q0 / (pi G)) (K(m) - E(m)) with
m = 1 - t^2 / a^2 for q = q0 sqrt(1 - r^2 / a^2). That g is continuous at c gives Lubkin's angle.
Nothing slips as friction grows: torque 16/3 G a^3 theta [Reissner and Sagoci 1944].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise

import numpy as np

from taccel_lab.errors import InputError

_POINTS = 200
"""Of Gauss-Legendre quadrature."""


def contact_radius(force_n: float, ball_m: float, young_pa: float, poisson: float) -> float:
    """Hertz's radius of contact of a rigid ball [m]."""
    return (3 * force_n * ball_m * (1 - poisson**2) / (4 * young_pa)) ** (1 / 3)


@dataclass(frozen=True)
class Torsion:
    """A contact that is turned by an angle."""

    shear_modulus_pa: float
    contact_m: float
    """Radius of the contact."""
    force_n: float
    """It is pressed with."""
    friction: float
    angle_rad: float
    """Not negative."""

    def __post_init__(self) -> None:
        for name in ("shear_modulus_pa", "contact_m", "force_n", "friction"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")
        if not self.angle_rad >= 0:
            raise InputError(f"angle_rad must not be negative, got {self.angle_rad}")

    @property
    def limit_nm(self) -> float:
        """Torque at which all of it slips."""
        return 3 * np.pi / 16 * self.friction * self.force_n * self.contact_m

    @property
    def stuck_nm(self) -> float:
        """Torque if nothing slipped."""
        return 16 / 3 * self.shear_modulus_pa * self.contact_m**3 * self.angle_rad

    @cached_property
    def stuck_part(self) -> float:
        """Radius of the disc that sticks, as a part of the contact's."""
        from scipy.optimize import brentq

        a = self.contact_m
        scale = self.friction * self.force_n / (self.shear_modulus_pa * a**2) * 3 / (4 * np.pi)
        if self.angle_rad == 0:
            return 1.0
        wished = self.angle_rad / scale
        # K - E grows without bound as c goes to 0, as slowly as a logarithm.
        smallest = 1e-150
        if wished >= _slip(smallest):
            return 0.0
        return float(brentq(lambda c: _slip(c) - wished, smallest, 1.0))  # type: ignore[arg-type]

    @property
    def torque_nm(self) -> float:
        """Torque of the contact."""
        a, total = self.contact_m, 0.0
        for low, high in pairwise((0.0, self.stuck_part, 1.0)):
            t, weight = _gauss(a * low, a * high)
            total += float((weight * t * self._g(t)).sum())
        return 4 * np.pi * self.shear_modulus_pa * total

    def moved_m(self, radius_m: np.ndarray) -> np.ndarray:
        """How far points of the face at distances from the axis [n] go around it [m], [n]."""
        found = []
        for r in np.asarray(radius_m, dtype=np.float64):
            end = min(r, self.contact_m) / self.contact_m
            edges = sorted({0.0, min(self.stuck_part, end), end})
            total = 0.0
            for low, high in pairwise(edges):
                # t = r sin(phi) takes the root away.
                phi, weight = _gauss(
                    *np.arcsin(np.minimum(np.array([low, high]) * self.contact_m / r, 1))
                )
                t = r * np.sin(phi)
                total += float((weight * t * self._g(t)).sum())
            found.append(total / r if r > 0 else 0.0)
        return np.array(found)

    def _g(self, t: np.ndarray) -> np.ndarray:
        c = self.stuck_part * self.contact_m
        q0 = 1.5 * self.friction * self.force_n / (np.pi * self.contact_m**2)
        slipping = 2 * t * q0 / (np.pi * self.shear_modulus_pa) * _slip(t / self.contact_m)
        return np.where(t <= c, 4 * self.angle_rad * t / np.pi, slipping)


def _slip(part: float | np.ndarray) -> np.ndarray:
    """K(m) - E(m), m = 1 - part^2."""
    from scipy.special import ellipe, ellipkm1

    return ellipkm1(np.square(part)) - ellipe(1 - np.square(part))


def _gauss(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    x, weight = _rule()
    return low + (high - low) * (x + 1) / 2, weight * (high - low) / 2


@cache
def _rule() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(_POINTS)
