# SPDX-License-Identifier: Apache-2.0
"""The suite ``press_accuracy``: how far presses are from the exact solution, and what they state.

Every sensor of the catalogue is pressed off its mesh's symmetry with balls, tools with rims and a
triangle, at two depths; flat pads from 0.8 to 10 mm are pressed with small and large balls and a
punch, and gels that relax at several speeds. Poisson's ratios and friction take turns. Each case is
pressed by the grades and by ``--accuracy 3%`` and ``1%``.

The truth is a mesh of twice as many elements along every side, less what ``dhat`` and the length of
the steps add: both are of first order and do not depend on the mesh, so coarse presses measure them
(``NEARER`` times smaller ``dhat``, as many times the steps). Heights are compared on 160 pixels
across the sensor's view, less those at rest. Pixels where the gel stands steeper than 60 degrees
are left out: on the sides of a dome heights along the view are differences of where a facet happens
to end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.measure import clock_of
from taccel_lab.benchmarks.results import ResultFile, Suite
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_known
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressOutcome,
    PressPath,
    PressPhysics,
    PressSetup,
    layered_material,
    parse_indenter,
    simulate_press,
)
from taccel_lab.presses.numerical_error import measured_press
from taccel_lab.presses.outcome import SeenFrom
from taccel_lab.presses.physics import parse_accuracy
from taccel_lab.presses.resolution import BESIDE, FINER, Resolution
from taccel_lab.scene import Material, MaxwellBranch, TriangleMesh
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.tasks.peg_scene import prism

AT_MM = (0.7, -0.4)
TOOLS = {
    "ball 1.5": "sphere:1.5",
    "ball 4": "sphere:4",
    "ball 8": "sphere:8",
    "ball 1": "sphere:1",
    "ball 0.5": "sphere:0.5",
    "roller": "roller:2x6",
    "punch": "cylinder:2",
    "edge": "edge:90x6",
    "STL triangle": "",
}
"""What presses, by name; the triangle stands for a user's own STL."""
DEPTHS_MM = (0.1, 0.6)
MATERIALS = (
    (0.46, 0.0),
    (0.40, 0.5),
    (0.499, 0.0),
    (0.46, 1.0),
    (0.40, 0.0),
    (0.49, 0.5),
    (0.499, 1.0),
)
"""Poisson's ratio and friction, in turn; each family begins one further on: every tool meets
all of them."""
PADS = (
    (10.0, "ball 1", 0.02), (10.0, "ball 1", 0.05), (10.0, "ball 0.5", 0.02), (6.0, "ball 4", 1.5),
    (0.8, "ball 4", 0.04), (0.8, "ball 4", 0.3), (1.0, "punch", 0.05), (2.0, "punch", 0.3),
    (2.0, "ball 8", 0.1),
)  # fmt: skip
"""Flat pads besides the catalogue's: thickness, tool, depth [mm]."""
PAD_RATIOS = (0.40, 0.46, 0.49)
RELAXING = (
    (0.2, 0.1, ((1.0, 1.0),)), (0.2, 1.0, ((2.0, 0.1),)),
    (0.6, 1.0, ((0.5, 0.05), (0.5, 1.0))), (0.05, 1.0, ((1.0, 0.02),)),
)  # fmt: skip
"""Flat pads that relax: depth [mm], speed [mm/s] and branches (relative modulus, time [s])."""
RELAXING_TOOLS = ("ball 4", "ball 1.5", "punch")
GRADES = ("fast", "default")
ASKED = ("3%", "1%")
NEARER = 8
"""Factor of ``dhat`` and the steps, for the truth."""
FINE = 2.0
"""Elements along a side over those of the default, for the truth."""
LEVELS = 2
"""Levels that a percentage may go up."""
GRID_PX = 160
STEEPEST_DEG = 60.0


@dataclass(frozen=True)
class PressAccuracy(Suite):
    """Errors of presses, and what they state: every sensor, tools with and without rims."""

    name: ClassVar[str] = "press_accuracy"
    what: ClassVar[str] = "Force and heights of presses against those of a fine mesh."
    shown: ClassVar[tuple[str, ...]] = (
        "cause",
        "force_error",
        "estimated_force_error",
        "height_rms_m",
        "estimated_height_rms_m",
    )
    families: tuple[str, ...] = ()
    """Sensors of the catalogue; all of them when none is named."""
    tools: tuple[str, ...] = tuple(TOOLS)
    """What presses, by its name in the result."""
    quick: bool = False
    """Compare fast and 3% with the default, to see that it works."""

    def settings(self) -> dict[str, Any]:
        for name in self.families:
            sensor_family(name)
        for name in self.tools:
            require_known("tool", name, TOOLS)
        return super().settings() | {
            "default": PHYSICS[Accuracy.DEFAULT].record(),
            "fine": FINE,
            "nearer": NEARER,
            "levels": LEVELS,
        }

    def measure_rows(self, result: ResultFile) -> None:
        compared = ("fast", "3%") if self.quick else (*GRADES, *ASKED)
        fine = 1.0 if self.quick else FINE
        for case in all_cases():
            if case.tool in self.tools and case.family in (self.families or (case.family,)):
                for accuracy in compared:
                    row = partial(measure, case, accuracy, fine, self.device)
                    result.measure(f"{case.label}, {accuracy}", row)


@dataclass(frozen=True)
class PressCase:
    """One press, without its mesh."""

    family: str
    tool: str
    depth_mm: float
    poisson_ratio: float
    friction: float
    thickness_mm: float | None = None
    """Thickness of a pad that is not the catalogue's."""
    speed_mm_s: float = 1.0
    branches: tuple[tuple[float, float], ...] = ()
    """Relative modulus and time [s] of each."""

    @property
    def label(self) -> str:
        pad = "" if self.thickness_mm is None else f" of {self.thickness_mm:g} mm"
        pad += " that relaxes" if self.branches else ""
        return f"{self.family}{pad}, {self.tool}, {self.depth_mm:g} mm"

    @property
    def remembers(self) -> bool:
        """Whether its state depends on the path."""
        return self.friction > 0 or bool(self.branches)

    def indenter(self) -> Indenter:
        """What presses."""
        text = TOOLS[self.tool]
        return parse_indenter(text) if text else Indenter(self.tool, triangle_prism())

    def parameters(self) -> FamilyParameters:
        """Parameters of the sensor."""
        given = {} if self.thickness_mm is None else {"thickness_mm": self.thickness_mm}
        return sensor_family(self.family).parameters(given)


def all_cases() -> Iterator[PressCase]:
    """Every family with each tool and depth; tool by tool, so that the rows that a budget allows
    say something about all families. Then pads of other thicknesses."""
    common = [name for name in TOOLS if name not in ("ball 1", "ball 0.5")]
    for i, (tool, depth_mm) in enumerate(itertools.product(common, DEPTHS_MM)):
        for first, family in enumerate(sensor_families()):
            poisson_ratio, friction = MATERIALS[(first + i) % len(MATERIALS)]
            yield PressCase(family, tool, depth_mm, poisson_ratio, friction)
    for (thickness_mm, tool, depth_mm), ratio in itertools.product(PADS, PAD_RATIOS):
        yield PressCase("flat_pad", tool, depth_mm, ratio, 0.0, thickness_mm)
    for tool, (depth_mm, speed, branches) in itertools.product(RELAXING_TOOLS, RELAXING):
        yield PressCase("flat_pad", tool, depth_mm, 0.46, 0.0, speed_mm_s=speed, branches=branches)


def triangle_prism(side_m: float = 5e-3, height_m: float = 3e-3) -> TriangleMesh:
    """What a user's STL might be: a prism over a triangle, its flat side down."""
    angle = np.radians([90.0, 210.0, 330.0])
    corners = side_m / math.sqrt(3) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    above = prism(corners, [(0, 1, 2)], height_m)
    return TriangleMesh(above.vertices_m - [0, 0, height_m / 2], above.faces)


def press(case: PressCase, physics: PressPhysics, at: Resolution, device: str) -> PressOutcome:
    """Press; SimulationError without convergence."""
    indenter, parameters = case.indenter(), case.parameters()
    branches = tuple(MaxwellBranch(*branch) for branch in case.branches)
    layers = [
        Material(layer.young_modulus_pa, case.poisson_ratio, branches=branches)
        for layer in parameters.layer_materials()
    ]
    path = PressPath(case.depth_mm, speed_mm_s=case.speed_mm_s)
    setup = PressSetup.on_pad(
        parameters.pad(),
        partial(layered_material, layers),
        indenter,
        AT_MM,
        path,
        poisson_ratio=case.poisson_ratio,
        friction_coefficient=case.friction,
        physics=physics,
        resolution=at,
        device=device,
    )
    whole = path.bounded(branches, case.friction)
    return simulate_press(
        setup,
        AT_MM,
        at.path(whole, indenter.shape, case.friction, relaxes=bool(branches)),
        SeenFrom(coarse_grid(parameters.grid())),
        beside=whole if at == BESIDE and case.remembers else None,
    )


def measured_case(case: PressCase, accuracy: str, device: str) -> tuple[dict[str, Any], np.ndarray]:
    """Figures of the press of a grade or a percentage, with what it states of its own errors; and
    its height less that at rest [m], [height_px, width_px]."""
    asked, clock = parse_accuracy(accuracy), clock_of(device)
    started = clock()
    physics = PHYSICS[asked if isinstance(asked, Accuracy) else Accuracy.DEFAULT]
    measured = measured_press(
        lambda at: press(case, physics, at, device),
        physics,
        case.indenter().shape,
        friction=case.friction,
        remembers=case.remembers,
        asked=None if isinstance(asked, Accuracy) else asked,
        levels=LEVELS,
    )
    found = measured.error.stated_for(measured.outcome)
    last = found.last
    figures = {
        "force_n": found.force_n,
        "estimated_force_error": found.force_error_n / abs(found.force_n),
        "estimated_height_rms_m": found.height_error_m,
        # What the error rests on, in words.
        "measured": measured.error.words(),
        # Without what the press beside it takes off.
        "solved_n": measured.outcome.force_n,
        "residual": float(last.residual_n[0] / max(last.contact_force_n[0], 1e-9)),
        "nodes": found.mesh.node_count,
        "newton_iterations": int(sum(s.report.newton_iterations[0] for s in found.steps)),
        "seconds": clock() - started,
    }
    return figures, _moved_m(found)


def _moved_m(found: PressOutcome) -> np.ndarray:
    """Height less that at rest [m], [height_px, width_px], NaN where the gel is steep."""
    upright = found.normals[..., 2] >= math.cos(math.radians(STEEPEST_DEG))
    return np.where(upright, found.height_m - found.rest_height_m, np.nan)


@dataclass(frozen=True)
class Truth:
    """What a press would give without its errors."""

    force_n: float
    moved_m: np.ndarray
    node_count: int


# The rows of a case follow one another and share its truth.
@lru_cache(maxsize=2)
def truth(case: PressCase, fine: float, device: str) -> Truth:
    """The fine mesh's press, less what dhat and steps add; SimulationError without convergence."""
    physics = PHYSICS[Accuracy.DEFAULT]

    def at(mesh: float, nearer: int, steps: int) -> PressOutcome:
        return press(case, physics, Resolution(mesh, 1 / nearer, steps), device)

    finest, coarse = at(fine, 1, 1), at(1 / FINER, 1, 1)
    others = [at(1 / FINER, NEARER, 1)]
    if case.remembers:
        others.append(at(1 / FINER, 1, NEARER))
    force, moved = float(finest.steps[-1].wrench[2]), _moved_m(finest)
    for other in others:
        rest = NEARER / (NEARER - 1)
        force += rest * float(other.steps[-1].wrench[2] - coarse.steps[-1].wrench[2])
        moved = moved + rest * (_moved_m(other) - _moved_m(coarse))
    return Truth(force, moved, finest.mesh.node_count)


def coarse_grid(view: PixelGrid) -> PixelGrid:
    """The sensor's view on fewer pixels."""
    coarser = view.width_px / GRID_PX
    rows = max(2, round(view.height_px / coarser))
    return PixelGrid(GRID_PX, rows, coarser * view.mm_per_px_x, coarser * view.mm_per_px_y)


def measure(case: PressCase, accuracy: str, fine: float, device: str) -> dict[str, Any]:
    """One row; ``cause`` says why it has no figures: one of the presses did not converge."""
    row: dict[str, Any] = {**asdict(case), "setting": accuracy, "cause": ""}
    try:
        figures, moved_m = measured_case(case, accuracy, device)
    except (InputError, SimulationError) as error:
        return row | {"cause": str(error)}
    try:
        true = truth(case, fine, device)
    except (InputError, SimulationError) as error:
        return row | {"cause": f"converged run: {error}"}
    return (
        row
        | figures
        | {
            "converged_n": true.force_n,
            "force_error": figures["force_n"] / true.force_n - 1,
            "solved_error": figures["solved_n"] / true.force_n - 1,
            "height_rms_m": float(np.sqrt(np.nanmean((moved_m - true.moved_m) ** 2))),
            "converged_nodes": true.node_count,
        }
    )
