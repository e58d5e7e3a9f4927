# SPDX-License-Identifier: Apache-2.0
"""Force-depth points of an indentation record, or of presses with both given, and their units.

Signs and order of a record were checked when it was read (``capture.record_checks``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder, ForceRecord
from taccel_lab.calibration.capture.records import FORCE_UNITS
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.gel import CurveTool, Gel
from taccel_lab.calibration.material.remarks import UNUSUAL_MODULUS
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_young_modulus_pa
from taccel_lab.report.remark import Remark

PLAUSIBLE_PA = (1e4, 1e7)
"""Young's moduli of gels; a fit outside is a fault of units."""
USUAL_PA = (2e4, 2.5e6)
"""Young's moduli that gels of tactile sensors have; used to guess which unit was meant."""
DEPTH_UNITS = {"m": 1e3, "cm": 10.0, "um": 1e-3}
"""Millimetres in one of a unit that depths are recorded in by mistake."""


@dataclass(frozen=True)
class IndentationPoints:
    """One press of one tool."""

    name: str
    source: str
    sha256: str
    tool: CurveTool
    depth_mm: np.ndarray
    """Depth past first touch, shape [point]."""
    force_n: np.ndarray
    """Normal force into the gel, shape [point]."""
    sigma_n: np.ndarray | None
    """Standard deviation of each force [N]; None where the record does not say."""
    zero: Estimate | None = None
    """What the load cell read in air, which is taken off the forces [N]."""

    @property
    def deepest_mm(self) -> float:
        return float(self.depth_mm.max())

    def only(self, keep: np.ndarray) -> IndentationPoints:
        """Some of the points, those of a mask (bool, [point])."""
        sigma = None if self.sigma_n is None else self.sigma_n[keep]
        return replace(
            self, depth_mm=self.depth_mm[keep], force_n=self.force_n[keep], sigma_n=sigma
        )


def points_of_record(record: ForceRecord, gel: Gel, ball_mm: float | None) -> IndentationPoints:
    """The points of an indentation record below first touch.

    Raises:
        InputError: No depth above 0, too few forces there, or a missing tool.
    """
    points = _touching(
        record.name,
        record.source,
        record.sha256,
        gel.tool(record.entry.tool, ball_mm),
        record.columns["depth_mm"],
        record.columns["force_n"],
        record.sigma_n(),
    )
    return replace(points, zero=record.zero)


def points_of_presses(folder: CaptureFolder, gel: Gel) -> list[IndentationPoints]:
    """Ball presses whose manifest entries state both depth and force, one set for each ball."""
    found: dict[float, list[tuple[float, float, str]]] = {}
    # Copies of a picture are one press.
    for press in {press.sha256: press for press in folder.presses}.values():
        depth, force = getattr(press, "depth_mm", None), getattr(press, "force_n", None)
        radius = getattr(press, "radius_mm", None) or folder.ball_radius_mm
        if depth and force is not None and radius is not None:
            found.setdefault(radius, []).append((depth, force, press.sha256))
    sets = []
    for radius, rows in sorted(found.items()):
        tool = gel.tool(ToolEntry(kind="sphere", radius_mm=radius))
        depth, force = np.array([row[:2] for row in rows]).T
        name = f"ball presses of {radius:g} mm"
        sets.append(_touching(name, folder.source, rows[0][2], tool, depth, force, None))
    return sets


def require_plausible(
    points: Sequence[IndentationPoints], thickness_mm: float, poisson_ratio: float
) -> tuple[float, list[Remark]]:
    """Young's modulus of all points by the closed form [Pa]; refuses what no gel can be.

    Raises:
        InputError: A modulus outside 1e4 to 1e7 Pa, with the unit that would fit.
    """
    moduli, remarks = [], []
    for item in points:
        modulus = _linear_modulus_pa(item, 1.0, thickness_mm, poisson_ratio)
        low, high = PLAUSIBLE_PA
        if not low <= modulus <= high:
            raise InputError(
                f"{item.source}: forces and depths give Young's modulus of {modulus:.3g} Pa; gels "
                f"have {low:g} to {high:g} Pa. {_guess(item, thickness_mm, poisson_ratio)}"
            )
        if not USUAL_PA[0] <= modulus <= USUAL_PA[1]:
            remarks.append(
                UNUSUAL_MODULUS(
                    name=item.name,
                    modulus_pa=modulus,
                    low_pa=USUAL_PA[0],
                    high_pa=USUAL_PA[1],
                    guess=_guess(item, thickness_mm, poisson_ratio),
                )
            )
        moduli.append(modulus)
    return float(np.exp(np.mean(np.log(moduli)))), remarks


def _linear_modulus_pa(
    item: IndentationPoints, depth_factor: float, thickness_mm: float, poisson_ratio: float
) -> float:
    tool = item.tool
    depth = item.depth_mm * depth_factor
    if tool.kind == "sphere":
        depth = np.minimum(depth, 0.9 * tool.radius_mm)
    return layer_young_modulus_pa(
        tool.kind, depth, item.force_n, tool.radius_mm, thickness_mm, poisson_ratio
    )


def _guess(item: IndentationPoints, thickness_mm: float, poisson_ratio: float) -> str:
    """Which units would give a usual gel, in words."""
    modulus = _linear_modulus_pa(item, 1.0, thickness_mm, poisson_ratio)
    fits = [
        f"force in {unit} ({modulus * factor:.2g} Pa)"
        for unit, factor in FORCE_UNITS.items()
        if USUAL_PA[0] <= modulus * factor <= USUAL_PA[1]
    ]
    for unit, factor in DEPTH_UNITS.items():
        if item.deepest_mm * factor <= 0.75 * thickness_mm:
            changed = _linear_modulus_pa(item, factor, thickness_mm, poisson_ratio)
            if USUAL_PA[0] <= changed <= USUAL_PA[1]:
                fits.append(f"depth in {unit} ({changed:.2g} Pa)")
    if not fits:
        return "No common mistake of units explains it; check the tool's radius and the thickness"
    return f"What would fit: {', or '.join(fits)}"


def _touching(
    name: str,
    source: str,
    sha256: str,
    tool: CurveTool,
    depth: np.ndarray,
    force: np.ndarray,
    sigma: np.ndarray | None,
) -> IndentationPoints:
    touching = depth > 0
    if not touching.any():
        raise InputError(
            f"{source}: no row lies below first touch; depth_mm must be positive into the gel "
            f"(found {depth.min():g} to {depth.max():g} mm)"
        )
    positive = force[touching] > 0
    if positive.mean() < 0.5:
        raise InputError(
            f"{source}: {(~positive).sum()} of {len(positive)} rows below first touch show no "
            "force; is depth_mm counted from first touch?"
        )
    return IndentationPoints(
        name,
        source,
        sha256,
        tool,
        depth[touching],
        force[touching],
        None if sigma is None else sigma[touching],
    )
