# SPDX-License-Identifier: Apache-2.0
"""What is pressed where: the gel of a profile, a tool, and measured points.

Simulated forces scale exactly with all moduli together (also the contact stiffness follows them),
so every press here is that of a gel of 1 MPa, and Young's modulus never needs a simulation. The
layers over a gel keep their ratio to it. Element, mesh, contact range and tolerance are those of
``taccel_lab.presses.physics``, which ``taccel-lab press`` presses with: what is fitted here comes
out there. Signs and order of a record of points were checked when it was read
(``capture.records``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder, ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.presses import Indenter, parse_indenter
from taccel_lab.presses.bonded_layer import ToolKind
from taccel_lab.presses.mesh import Pad
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.profile import MaterialBlock, SensorProfile
from taccel_lab.sensors.registry import profile_parameters

UNIT_MODULUS_PA = 1e6


@dataclass(frozen=True)
class CurveTool:
    """A rigid tool and where it comes down."""

    kind: ToolKind
    radius_mm: float
    """Radius of the ball or the punch; of the disc of the gel's area for a plate [mm]."""
    at_mm: tuple[float, float]
    description: str
    """Description as ``parse_indenter`` reads it."""

    def indenter(self) -> Indenter:
        return parse_indenter(self.description)


@dataclass(frozen=True)
class Gel:
    """The gel of a profile: its pad, its material but for scale, and how its presses are
    simulated."""

    pad: Pad
    material: MaterialBlock
    thickness_mm: float
    device: str = "cpu"
    """Warp device of its simulations."""
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT]

    @classmethod
    def of_profile(
        cls,
        profile: SensorProfile,
        model: str | None = None,
        device: str = "cpu",
        physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
    ) -> Gel:
        """The gel of ``profile``, with another law where one is requested."""
        material = profile.material
        if model is not None and model != material.model:
            try:
                material = material.replace(model=model, mooney_ratio=0.0)
            except InputError as error:
                raise InputError(f"the law {model!r} is not known: {error}") from error
        return cls(
            profile_parameters(profile).pad(),
            material,
            profile.gel.thickness_mm,
            device,
            physics,
        )

    def with_law(self, poisson_ratio: float, mooney_ratio: float | None = None) -> Gel:
        """The same pad of another Poisson's ratio, and another Mooney ratio unless None."""
        ratio = self.material.mooney_ratio if mooney_ratio is None else mooney_ratio
        material = self.material.replace(poisson_ratio=poisson_ratio, mooney_ratio=ratio)
        return replace(self, material=material)

    def unit_material(self) -> MaterialBlock:
        """The material at 1 MPa, its layers in proportion, relaxed."""
        scale = UNIT_MODULUS_PA / self.material.young_modulus_pa
        layers = tuple(
            layer.replace(young_modulus_pa=layer.young_modulus_pa * scale)
            for layer in self.material.layers
        )
        return self.material.replace(young_modulus_pa=UNIT_MODULUS_PA, branches=(), layers=layers)

    def recipe(self) -> dict[str, Any]:
        """All of the gel but its law's ratios that forces of 1 MPa depend on, for a cache key."""
        unit = self.unit_material()
        return {
            "pad": repr(self.pad),
            "model": unit.model,
            "layers": [layer.model_dump() for layer in unit.layers],
        }

    def tool(self, entry: ToolEntry, default_radius_mm: float | None = None) -> CurveTool:
        """The tool of a record, checked against the pad."""
        x, y = entry.center_mm
        low, high = self.pad.bounds_mm()[:, :2]
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1]):
            raise InputError(
                f"the tool comes down at ({x:g}, {y:g}) mm, beside the pad: x must lie in "
                f"[{low[0]:g}, {high[0]:g}] mm and y in [{low[1]:g}, {high[1]:g}] mm"
            )
        if entry.kind == "flat":
            size = high - low
            radius = math.sqrt(float(size[0] * size[1]) / math.pi)
            width, depth = size + 2 * np.abs([x, y]) + 4.0
            return CurveTool("flat", radius, (x, y), f"box:{width:.6g}x{depth:.6g}")
        radius_mm = entry.radius_mm or (default_radius_mm if entry.kind == "sphere" else None)
        if radius_mm is None:
            raise InputError(
                f"the radius of the {entry.kind} is missing; give tool = {{ kind = "
                f'"{entry.kind}", radius_mm = ... }} with the record'
            )
        if radius_mm > 100:
            raise InputError(
                f"the radius of the {entry.kind} is {radius_mm:g} mm; at most 100 mm can be "
                'simulated, use kind = "flat" for a plate'
            )
        return CurveTool(entry.kind, radius_mm, (x, y), f"{entry.kind}:{radius_mm:.9g}")


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
