# SPDX-License-Identifier: Apache-2.0
"""How far quantities may be off that a profile states: measured intervals, or priors of 95 %.

A profile that says nothing of an error is not exact. Young's modulus of a gel nobody tested lies
within a factor of two: published simulations of one GelSight Mini use 0.01 to 1.0 MPa, its fit to
measured forces runs from 0.35 to 0.52. A cast pad is as thick as drawn to 5 % (a Mini's data sheet:
4.25 +- 0.20 mm). Scales published for one camera range over 10 % (0.058 to 0.065 mm/px); one that a
person measured on the gel is good to 2 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from taccel_lab.profile.schema import CameraBlock, GelBlock, MaterialBlock, Provenance

MODULUS_FACTOR = 2.0
"""Factor of Young's modulus, each way."""
THICKNESS_SHARE = 0.05
"""Share of the gel's thickness, each way."""
SCALE_SHARE: Mapping[str, float] = {"stated": 0.02, "measured": 0.02, "calibrated": 0.02}
"""Share of a scale of this kind, each way."""
OTHER_SCALE_SHARE = 0.05
"""Share of a published or assumed one."""
POISSON_RATIOS = (0.46, 0.4999)
"""Ratios of silicone gels: one that was tested has 0.485, one that was fitted 0.497, and their bulk
modulus of a gigapascal says 0.4999; simulations that keep away from locking take less."""


def modulus_interval_pa(material: MaterialBlock) -> tuple[float, float]:
    """95 % interval of Young's modulus [Pa]."""
    pa = material.young_modulus_pa
    known = _stated(material.provenance, "young_modulus_pa", pa)
    return known or (pa / MODULUS_FACTOR, pa * MODULUS_FACTOR)


def is_modulus_known(material: MaterialBlock) -> bool:
    """Whether the profile states how far Young's modulus may be off."""
    pa = material.young_modulus_pa
    return _stated(material.provenance, "young_modulus_pa", pa) is not None


def thickness_interval_mm(gel: GelBlock) -> tuple[float, float]:
    """95 % interval of the gel's thickness [mm]."""
    mm = gel.thickness_mm
    known = _stated(gel.provenance, "thickness_mm", mm)
    return known or (mm * (1 - THICKNESS_SHARE), mm * (1 + THICKNESS_SHARE))


def poisson_prior(material: MaterialBlock) -> tuple[float, float] | None:
    """95 % interval of a Poisson's ratio that nobody measured; None of a calibration, whose modulus
    was fitted with it."""
    if material.provenance.kind == "calibrated":
        return None
    low, high = POISSON_RATIOS
    ratio = material.poisson_ratio
    return min(low, ratio), max(high, ratio)


def scale_sigma(camera: CameraBlock) -> float:
    """Standard deviation of the scale as a share of it."""
    known, shares = camera.provenance, []
    for name in ("mm_per_px_x", "mm_per_px_y"):
        low, high = known.interval.get(name, (0.0, 0.0))
        if sigma := known.spread.get(name, (high - low) / 4):
            shares.append(sigma / getattr(camera, name))
    if shares:
        return math.hypot(*shares) / math.sqrt(len(shares))
    return SCALE_SHARE.get(known.kind, OTHER_SCALE_SHARE) / 2


def _stated(provenance: Provenance, name: str, value: float) -> tuple[float, float] | None:
    """The interval that is stated, or two standard deviations where these are; None where neither
    is, or the value lies outside."""
    interval = provenance.interval.get(name)
    if interval is None and 0 < provenance.spread.get(name, 0.0) < value / 2:
        off = 2 * provenance.spread[name]
        interval = value - off, value + off
    if interval is None or not 0 < interval[0] <= value <= interval[1]:
        return None
    return float(interval[0]), float(interval[1])
