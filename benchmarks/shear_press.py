# SPDX-License-Identifier: Apache-2.0
"""One press with shear, as a function of every setting: what ``convergence_study`` and the suite
``error`` vary.

A ball of 4 mm radius goes 0.6 mm into a bonded gel of 16 x 16 x 4 mm and then 0.3 mm sideways, with
friction 0.5; quasi-static, or with mass and damping in 8 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.benchmarks.clock import clock_of
from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.errors import SimulationError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeScheme,
    TimeStepping,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state

BALL_M, DEPTH_M, SHEAR_M, FRICTION = 4e-3, 6e-4, 3e-4, 0.5
YOUNG_PA, POISSON, DENSITY = 1.5e5, 0.45, 1000.0
DURATION_S, EPS_V_M_S, DAMPING_TIME_S = 8e-3, 2e-3, 5e-4
MARKERS_M = np.stack(np.meshgrid(*[1e-3 * np.linspace(-2.83, 3.17, 7)] * 2), axis=-1).reshape(-1, 2)
"""Points of the contact face at rest, on no node [m], shape [49, 2]."""
SURFACE_M = np.stack(np.meshgrid(*[1e-3 * np.linspace(-4.91, 5.03, 41)] * 2), axis=-1).reshape(
    -1, 2
)
"""Points whose height is compared: the ball's mark and 3 mm around it [m], shape [1681, 2]."""


@dataclass(frozen=True)
class Press:
    """Settings of one run."""

    element: Element = Element.QUADRATIC
    layers: int = 2
    """Layers of elements in the gel; the other directions are refined alike."""
    dhat_m: float = 2e-6
    kappa_over_young: float = 1.0
    friction_eps_m: float = 1e-7
    relative_tolerance: float = 1e-6
    steps: int = 0
    """Of the dynamic press; 0 is the quasi-static one."""
    scheme: TimeScheme = TimeScheme.EULER
    solver: tuple[tuple[str, Any], ...] = ()
    """Other settings of the solver, by name."""


@dataclass(frozen=True)
class Outcome:
    """What a run gave."""

    normal_n: float
    tangential_n: float
    markers_m: np.ndarray
    """Displacement of the markers in the plane [m], shape [marker, 2]."""
    heights_m: np.ndarray
    """Heights of the points of ``SURFACE_M``, which move with the gel [m], shape [point]."""
    node_count: int
    newton_iterations: int
    cg_iterations: int
    steps: int
    residual_ratio: float
    """Largest force residual of a step over its contact force."""
    seconds: float
    """Of the steps, by ``taccel_lab.benchmarks.clock``."""


def model_of(press: Press, device: str = "cpu") -> Model:
    """The gel, the ball and their material, on a device."""
    dynamic = press.steps > 0
    stepping = TimeStepping(
        quasi_static=not dynamic,
        dt_s=DURATION_S / press.steps if dynamic else 0.02,
        scheme=press.scheme,
    )
    material = Material(
        YOUNG_PA, POISSON, DENSITY, damping_time_s=DAMPING_TIME_S if dynamic else 0.0
    )
    soft = SoftBody(_mesh(press.layers), material, element=press.element)
    return Scene(soft, KinematicBody(Ball(BALL_M), FRICTION), time=stepping).finalize(device)


def run(press: Press, device: str = "cpu") -> Outcome:
    """Press, shear, read."""
    dynamic = press.steps > 0
    static = (
        {"friction_speed_m_s": EPS_V_M_S} if dynamic else {"friction_eps_m": press.friction_eps_m}
    )
    model = model_of(press, device)
    soft = model.scene.soft_bodies[0]
    solver = SolverIPC(
        model,
        SolverConfig(
            dhat_m=press.dhat_m,
            kappa_pa=press.kappa_over_young * YOUNG_PA,
            relative_tolerance=press.relative_tolerance,
            absolute_tolerance_n=1e-12,
            max_newton_iterations=500,
            **static,
            **dict(press.solver),
        ),
    )
    path = _dynamic_path(press.steps) if dynamic else _quasi_static_path()
    state = initial_state(model, _pose(*path[0]))
    clock = clock_of(device)
    reports, started = [], clock()
    for place in path[1:]:
        report = solver.step(state, _pose(*place))
        if not report.converged.all():
            raise SimulationError(f"{press} did not converge: {report.summary()}")
        reports.append(report)
    seconds = clock() - started
    soft_nodes = slice(0, model.soft_count)
    force = (solver.contact_gradient.numpy() + solver.friction_gradient.numpy())[0, soft_nodes]
    moved = state.positions.numpy()[0, soft_nodes] - soft.nodal_mesh.nodes_m
    return Outcome(
        normal_n=float(force[:, 2].sum()),
        tangential_n=-float(force[:, 0].sum()),
        markers_m=at_points(soft.nodal_mesh, moved, MARKERS_M)[:, :2],
        heights_m=at_points(soft.nodal_mesh, moved, SURFACE_M)[:, 2],
        node_count=model.soft_count,
        newton_iterations=sum(int(r.newton_iterations[0]) for r in reports),
        cg_iterations=sum(int(r.cg_iterations[0]) for r in reports),
        steps=len(reports),
        residual_ratio=max(
            float(r.residual_n[0] / max(r.contact_force_n[0], 1e-6)) for r in reports
        ),
        seconds=round(seconds, 3),
    )


def _mesh(layers: int) -> TetMesh:
    pad = GelPad(
        length_x_mm=16.0,
        length_y_mm=16.0,
        corner_radius_mm=1.0,
        thickness_mm=4.0,
        window_x_mm=12.0,
        window_y_mm=12.0,
    )
    return focused_gel_mesh(
        pad,
        FocusOptions(
            at_mm=(0.0, 0.0),
            radius_mm=2.5,
            size_mm=1.6 / layers,
            core=2 * layers,
            rings=max(3, round(1.5 * layers)),
            layers=layers,
            layer_ratio=1.15,
        ),
    )


def _pose(x: float, depth: float) -> np.ndarray:
    return np.array([[[x, 0.0, BALL_M - depth, 0.0, 0.0, 0.0, 1.0]]])


def _quasi_static_path() -> list[tuple[float, float]]:
    """Places of the ball: sideways, depth [m]; the first one is the start."""
    down = [(0.0, DEPTH_M * part) for part in (-0.3, 0.5, 1.0)]
    return down + [(SHEAR_M * part, DEPTH_M) for part in (0.5, 1.0)]


def _dynamic_path(steps: int) -> list[tuple[float, float]]:
    """Down and sideways at once, without a jump of the velocity at either end."""
    part = np.arange(steps + 1) / steps
    smooth = part**2 * (3 - 2 * part)
    start = -1e-4
    return [(SHEAR_M * s, start + (DEPTH_M - start) * s) for s in smooth]


def at_points(
    mesh: TetMesh | QuadraticMesh, values: np.ndarray, points_m: np.ndarray
) -> np.ndarray:
    """Nodal values [node, 3] on the contact face at points [n, 2] of it at rest, shape [n, 3]."""
    faces = mesh.region_faces(Region.CONTACT)
    a, b, c = (mesh.nodes_m[faces[:, k], :2] for k in range(3))
    ab, ac = b - a, c - a
    p = points_m[:, None] - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    u = (p[..., 0] * ac[:, 1] - p[..., 1] * ac[:, 0]) / area
    v = (ab[:, 0] * p[..., 1] - ab[:, 1] * p[..., 0]) / area
    weights = np.stack([1 - u - v, u, v], axis=-1)
    face = weights.min(axis=-1).argmax(axis=1)
    own = np.take_along_axis(weights, face[:, None, None], axis=1)[:, 0]
    return (own[..., None] * values[faces[face]]).sum(axis=1)
