# SPDX-License-Identifier: Apache-2.0
"""Loads at which figures are read are such as the presses of a study reach, by a closed form."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_force_n

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters
    from taccel_lab.studies.metrics.base import Metric

STIFFENED = 10.0
"""How much larger than by small strains the force of a deep press may be: a load beyond that is
reached by no press."""
_EQUATOR = 0.9
"""Depth, as a part of a ball's radius, at which the closed form ends."""


def require_bearable(
    metrics: Iterable[Metric], presses: Mapping[str, Any], designs: Sequence[FamilyParameters]
) -> None:
    """Refuse a load that none of the designs bears under the ball by which a figure is read.

    Args:
        metrics: Of the study, each of one load and indenter; other tools than balls are not judged.
        presses: By name, as of the study.
        designs: None where an optimiser finds them: nothing is rejected then.

    Raises:
        InputError: Names the load, and about what the press ends at.
    """
    for metric in metrics:
        tool, _, size = (metric.indenter or "").partition(":")
        if not (metric.at_load and designs and tool == "sphere"):
            continue
        press, ends = presses[metric.presses[0]], 0.0
        for design in designs:
            ends = max(ends, _end_n(press, float(size), design))
            if metric.load_n <= STIFFENED * ends:
                break
        else:
            raise InputError(
                f"{metric.name}: no gel of this study bears {metric.load_n:g} N; the press "
                f"{metric.presses[0]} of {metric.indenter} ends at about {ends:.2g} N. Give a "
                "smaller load_n"
            )


def _end_n(press: Any, radius_mm: float, design: FamilyParameters) -> float:
    """About the force of a press at its full depth [N], of the stiffest layer all through."""
    thickness = design.pad().thickness_mm
    layers = design.layer_materials()
    depth = min(press.full_depth_mm(thickness), _EQUATOR * radius_mm)
    modulus = max(layer.young_modulus_pa for layer in layers)
    nu = max(layer.poisson_ratio for layer in layers)
    return float(layer_force_n("sphere", depth, radius_mm, thickness, nu, modulus))
