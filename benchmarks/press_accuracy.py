# SPDX-License-Identifier: Apache-2.0
"""The suite ``press_accuracy``: how far presses of the catalogue are from those of a fine mesh.

Every sensor is pressed off its mesh's symmetry with balls, tools with rims and a triangle, at two
depths, with the meshes of ``fast`` and of the default; each press is compared with that of the
accuracy ``reference``. Heights are compared on 160 pixels across the sensor's view, less those at
rest: what a mesh leaves out of the rest shape does not come from the mesh
(``signals.rest_surface``). Pixels where the gel stands steeper than 60 degrees are left out: on the
sides of a dome heights along the view are differences of where a facet happens to end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_of
from taccel_lab.benchmarks.results import ResultFile
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressEnv,
    PressPath,
    layered_material,
    parse_indenter,
)
from taccel_lab.scene import Material, TriangleMesh
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.registry import sensor_families, sensor_family
from taccel_lab.signals import SignalTactile
from taccel_lab.tasks.peg_scene import prism

AT_MM = (0.7, -0.4)
TOOLS = {
    "ball 1.5": "sphere:1.5",
    "ball 4": "sphere:4",
    "ball 8": "sphere:8",
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
GRID_PX = 160
STEEPEST_DEG = 60.0


@dataclass(frozen=True)
class PressAccuracy(Suite):
    """Errors of presses with today's meshes: every sensor, tools with and without rims."""

    name: ClassVar[str] = "press_accuracy"
    what: ClassVar[str] = "Force and heights of presses against those with the reference's mesh."
    families: tuple[str, ...] = ()
    """Sensors of the catalogue; all of them when none is named."""
    tools: tuple[str, ...] = tuple(TOOLS)
    """What presses, by its name in the result."""
    quick: bool = False
    """Compare fast with the default, to see that it works."""

    def settings(self) -> dict[str, Any]:
        for name in self.families:
            sensor_family(name)
        unknown = [name for name in self.tools if name not in TOOLS]
        if unknown:
            raise InputError(f"no tool {unknown[0]!r}; known: {', '.join(TOOLS)}")
        return {a.value: PHYSICS[a].record() for a in (*self._compared(), self._reference())}

    def _compared(self) -> tuple[Accuracy, ...]:
        return (Accuracy.FAST,) if self.quick else (Accuracy.FAST, Accuracy.DEFAULT)

    def _reference(self) -> Accuracy:
        return Accuracy.DEFAULT if self.quick else Accuracy.REFERENCE

    def measure_rows(self, result: ResultFile) -> None:
        for case in all_cases():
            if case.tool in self.tools and case.family in (self.families or (case.family,)):
                for accuracy in self._compared():
                    row = partial(measure, case, accuracy, self._reference(), self.device)
                    result.measure(f"{case.label}, {accuracy}", row, describe)


@dataclass(frozen=True)
class Case:
    """One press, without its mesh."""

    family: str
    tool: str
    depth_mm: float
    poisson_ratio: float
    friction: float

    @property
    def label(self) -> str:
        return f"{self.family}, {self.tool}, {self.depth_mm:g} mm"

    def indenter(self) -> Indenter:
        """What presses."""
        text = TOOLS[self.tool]
        return parse_indenter(text) if text else Indenter(self.tool, triangle_prism())


@dataclass(frozen=True)
class Outcome:
    """What a press gave."""

    force_n: float
    moved_m: np.ndarray
    """Height less that at rest [m], [height_px, width_px], NaN where the gel is steep."""
    force_error_n: float
    """The estimate of the press itself, as the next one."""
    height_error_m: float
    residual: float
    """Over the contact force."""
    node_count: int
    newton_iterations: int
    seconds: float


def all_cases() -> Iterator[Case]:
    """Every family with each tool and depth; tool by tool, so that the rows that a budget allows
    say something about all families."""
    for i, (tool, depth_mm) in enumerate(itertools.product(TOOLS, DEPTHS_MM)):
        for first, family in enumerate(sensor_families()):
            poisson_ratio, friction = MATERIALS[(first + i) % len(MATERIALS)]
            yield Case(family, tool, depth_mm, poisson_ratio, friction)


def triangle_prism(side_m: float = 5e-3, height_m: float = 3e-3) -> TriangleMesh:
    """What a user's STL might be: a prism over a triangle, its flat side down."""
    angle = np.radians([90.0, 210.0, 330.0])
    corners = side_m / math.sqrt(3) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    above = prism(corners, [(0, 1, 2)], height_m)
    return TriangleMesh(above.vertices_m - [0, 0, height_m / 2], above.faces)


# The rows of a case follow one another and share its reference.
@lru_cache(maxsize=2)
def press(case: Case, accuracy: Accuracy, device: str) -> Outcome:
    """Press with the mesh and the settings of an accuracy; SimulationError without convergence."""
    physics, indenter = PHYSICS[accuracy], case.indenter()
    mesh = press_mesh(case.family, {}, AT_MM, indenter.contact(case.depth_mm), physics.mesh)
    parameters = sensor_family(case.family).parameters()
    layers = [
        Material(layer.young_modulus_pa, case.poisson_ratio)
        for layer in parameters.layer_materials()
    ]
    env = PressEnv(
        mesh,
        layered_material(layers, mesh),
        indenter,
        np.array([AT_MM]),
        friction_coefficient=case.friction,
        physics=physics,
        device=device,
    )
    clock = clock_of(device)
    started = clock()
    reports = env.follow(PressPath(case.depth_mm))
    seconds = clock() - started
    signal = SignalTactile(env.mesh, coarse_grid(parameters.grid()), env_count=2, device=device)
    shapes = np.stack([env.mesh.nodes_m, env.positions[0]])
    signal.update(wp.array(shapes, dtype=wp.vec3d, device=device))
    upright = signal.normals.numpy()[0, ..., 2]
    at_rest, pressed = signal.height_m.numpy().astype(float)
    moved = pressed - at_rest
    estimate = env.error_estimate()
    return Outcome(
        force_n=float(env.press_force[0, 2]),
        moved_m=np.where(upright >= math.cos(math.radians(STEEPEST_DEG)), moved, np.nan),
        force_error_n=float(estimate.force_n[0]),
        height_error_m=float(estimate.height_m[0]),
        residual=float(reports[-1].residual_n[0] / max(reports[-1].contact_force_n[0], 1e-9)),
        node_count=env.mesh.node_count,
        newton_iterations=int(sum(report.newton_iterations[0] for report in reports)),
        seconds=seconds,
    )


def coarse_grid(view: PixelGrid) -> PixelGrid:
    """The sensor's view on fewer pixels."""
    coarser = view.width_px / GRID_PX
    rows = max(2, round(view.height_px / coarser))
    return PixelGrid(GRID_PX, rows, coarser * view.mm_per_px_x, coarser * view.mm_per_px_y)


def measure(case: Case, accuracy: Accuracy, reference: Accuracy, device: str) -> dict[str, Any]:
    """One row; ``cause`` says why it has no figures: one of the two did not converge."""
    row: dict[str, Any] = {**asdict(case), "setting": accuracy.value, "cause": ""}
    try:
        found = press(case, accuracy, device)
    except SimulationError as error:
        return row | {"cause": str(error)}
    try:
        converged = press(case, reference, device)
    except SimulationError as error:
        return row | {"cause": f"converged run: {error}"}
    apart = found.moved_m - converged.moved_m
    return row | {
        "force_n": found.force_n,
        "converged_n": converged.force_n,
        "force_error": found.force_n / converged.force_n - 1,
        "estimated_force_error": found.force_error_n / abs(found.force_n),
        "height_rms_m": float(np.sqrt(np.nanmean(apart**2))),
        "estimated_height_rms_m": found.height_error_m,
        "residual": found.residual,
        "nodes": found.node_count,
        "converged_nodes": converged.node_count,
        "newton_iterations": found.newton_iterations,
        "seconds": found.seconds,
    }


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    label = f"{row['family']}, {row['tool']}, {row['depth_mm']:g} mm, {row['setting']}"
    if row["cause"]:
        return f"{label}: {row['cause']}"
    return (
        f"{label}: force {row['force_error']:+.2%} (estimate {row['estimated_force_error']:.2%}), "
        f"heights {1e6 * row['height_rms_m']:.2f} um "
        f"(estimate {1e6 * row['estimated_height_rms_m']:.2f} um)"
    )
