# SPDX-License-Identifier: Apache-2.0
"""Spread between units of one design, from their profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.light.fit import fit_light
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile

MEASURED = ("measured", "calibrated")
"""Kinds of blocks whose values say something about the unit at hand."""


@dataclass(frozen=True)
class UnitSpread:
    """Standard deviations between units; None of what fewer than two of them measured."""

    unit_count: int
    lights: tuple[LightDrift, ...]
    """Light of each unit against the mean of all images at rest; empty without images."""
    mm_per_px_relative: float | None
    center_px: float | None
    young_modulus_relative: float | None
    friction_coefficient: float | None


def spread_of_units(profiles: Sequence[SensorProfile]) -> UnitSpread:
    """Compare units of one family; values that were assumed or published count for nothing.

    Raises:
        InputError: Fewer than two profiles, profiles of different families, or one and the same
            calibration twice.
    """
    if len(profiles) < 2:
        raise InputError(f"the spread between units needs at least 2 profiles, got {len(profiles)}")
    families = sorted({profile.sensor.family for profile in profiles})
    if len(families) > 1:
        raise InputError(f"the profiles are of different families: {', '.join(families)}")
    for k, other in enumerate(profiles):
        for i, one in enumerate(profiles[:k]):
            shared = shared_measurement(one, other)
            if shared is not None:
                raise InputError(
                    f"profiles {i + 1} and {k + 1} of the units hold the same {shared}: they are "
                    "of one unit, whose spread would come out too small. Give each unit once"
                )
    cameras = [p.camera for p in profiles if p.camera.provenance.kind in MEASURED]
    scales = [math.sqrt(c.mm_per_px_x * c.mm_per_px_y) for c in cameras]
    centers = np.array([(c.center_u_px, c.center_v_px) for c in cameras]).reshape(-1, 2)
    materials = [p.material for p in profiles if p.material.provenance.kind in MEASURED]
    moduli = [m.young_modulus_pa for m in materials]
    return UnitSpread(
        unit_count=len(profiles),
        lights=_lights(profiles),
        mm_per_px_relative=_relative(scales),
        center_px=None if len(centers) < 2 else float(np.sqrt(centers.var(axis=0, ddof=1).mean())),
        young_modulus_relative=_relative(moduli),
        friction_coefficient=None
        if len(materials) < 2
        else float(np.std([m.friction_coefficient for m in materials], ddof=1)),
    )


def shared_measurement(one: SensorProfile, other: SensorProfile) -> str | None:
    """What both profiles took from one and the same measurement; None if nothing."""
    if (
        one.background_rgb is not None
        and other.background_rgb is not None
        and np.array_equal(one.background_rgb, other.background_rgb)
    ):
        return "image at rest"
    for key in ("camera", "material"):
        inputs = [getattr(p, key).provenance.inputs for p in (one, other)]
        if getattr(one, key).provenance.kind in MEASURED and inputs[0] and inputs[0] == inputs[1]:
            return f"captures behind the block {key}"
    return None


def _relative(values: Sequence[float]) -> float | None:
    if len(values) < 2:
        return None
    return float(np.std(values, ddof=1) / np.mean(values))


def _lights(profiles: Sequence[SensorProfile]) -> tuple[LightDrift, ...]:
    images = [p.background_rgb for p in profiles if p.background_rgb is not None]
    if len(images) < 2 or len({image.shape for image in images}) > 1:
        return ()
    mean = np.mean([image.astype(np.float64) for image in images], axis=0)
    return tuple(fit_light(image.astype(np.float64), mean) for image in images)
