# SPDX-License-Identifier: Apache-2.0
"""Whether a press is simulated as those were that a profile's material was fitted with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from taccel_lab.presses.physics import PressPhysics

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock

_WORDS = {
    "accuracy": "accuracy",
    "element": "elements",
    "mesh": "mesh",
    "dhat_m": "contact range in metres",
    "relative_tolerance": "tolerance",
}


def physics_difference(
    material: MaterialBlock, physics: PressPhysics, friction_coefficient: float
) -> str | None:
    """One sentence on how a press differs from those that the material was fitted with.

    Args:
        material: Of the profile that is pressed.
        physics: Of the press.
        friction_coefficient: Of the press, between tool and gel.

    Returns:
        None for a press like those of the fit, and for a material that was not fitted to presses.
    """
    fitted = material.fitted_with
    if fitted is None:
        provenance = material.provenance
        if provenance.kind != "calibrated" or "young_modulus_pa" not in provenance.spread:
            return None
        return (
            "It is not recorded what this profile's material was fitted with (an older version "
            "wrote it): forces may differ by tens of per cent from those of its records. Run "
            "taccel-lab calibrate material again"
        )
    found = [
        f"{_WORDS.get(name, name)} {_plain(old)} (this press: {_plain(new)})"
        for name, old, new in _differences(fitted.physics, physics.record())
    ]
    if fitted.friction_coefficient != friction_coefficient:
        found.append(
            f"friction {fitted.friction_coefficient:g} (this press: {friction_coefficient:g})"
        )
    if not found:
        return None
    return (
        f"The material of this profile was fitted with {', '.join(found)}: the forces of this "
        "press are not those that its calibration stands for"
    )


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Settings that differ: name, old value, new value; None for one that is missing."""
    if old.get("accuracy") != new.get("accuracy"):
        # It stands for the settings that it chooses.
        return [("accuracy", old.get("accuracy"), new.get("accuracy"))]
    found: list[tuple[str, Any, Any]] = []
    for name in sorted({*old, *new}):
        one, other = old.get(name), new.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found += [(f"{name}.{k}", a, b) for k, a, b in _differences(one, other)]
        elif one != other:
            found.append((name, one, other))
    return found


def _plain(value: Any) -> str:
    if value is None:
        return "not stated"
    return f"{value:g}" if isinstance(value, float) else str(value)
