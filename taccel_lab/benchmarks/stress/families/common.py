# SPDX-License-Identifier: Apache-2.0
"""What most families draw: a material, a time step, a mesh, the settings of the solver."""

from __future__ import annotations

import numpy as np

from taccel_lab.benchmarks.stress.case import Draw
from taccel_lab.benchmarks.stress.shapes import soft_ball, soft_box, with_slivers
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Element, Material, MaterialModel, SoftBody, TimeScheme, TimeStepping
from taccel_lab.solvers import SolverConfig

FREE = np.zeros(0, dtype=np.int64)
"""No bonded node."""
ELEMENTS = (Element.LINEAR, Element.QUADRATIC)
LAWS = tuple(MaterialModel)
WORLD = np.array([0.0, 0, 0, 0, 0, 0, 1])


def material(
    draw: Draw,
    name: str = "material",
    young_pa: tuple[float, float] = (1e3, 1e9),
    density: tuple[float, float] = (100.0, 1e4),
) -> Material:
    """Any of the four laws, from foam to steel, up to nearly incompressible."""
    law = draw.choose(f"{name} law", LAWS)
    # Half of all near 0.5: that is where gels are.
    nu = 0.5 - draw.decades(f"{name} 0.5 - nu", 1e-3, 0.5)
    ratio = 0.0
    if law is MaterialModel.MOONEY_RIVLIN:
        # nu >= r / (1 + 2 r)
        ratio = draw.between(f"{name} mooney part", 0.0, 0.99) * min(1.0, nu / (1 - 2 * nu))
    return Material(
        draw.decades(f"{name} young", *young_pa),
        nu,
        draw.decades(f"{name} density", *density),
        law,
        ratio,
    )


def in_time(
    draw: Draw, dt_s: tuple[float, float] = (1e-4, 0.1), gravity: float = 9.81
) -> TimeStepping:
    """A dynamic scene; BDF2 in a third of all."""
    bdf2 = draw.chance("bdf2", 0.33)
    return TimeStepping(
        quasi_static=False,
        dt_s=draw.decades("dt", *dt_s),
        gravity_m_s2=(0.0, 0.0, -gravity),
        scheme=TimeScheme.BDF2 if bdf2 else TimeScheme.EULER,
    )


def maybe_in_time(draw: Draw) -> TimeStepping:
    """Quasi-static in half of all."""
    return TimeStepping() if draw.chance("quasi-static", 0.5) else in_time(draw)


def friction(draw: Draw, name: str = "friction") -> float:
    """0 in a quarter of all, else up to 2."""
    return 0.0 if draw.chance(f"no {name}", 0.25) else draw.between(name, 0.01, 2.0)


def settings(
    draw: Draw, dhat_m: tuple[float, float] = (1e-5, 2e-4), **other: float
) -> SolverConfig:
    """Default settings but for the range of contact."""
    return SolverConfig(dhat_m=draw.decades("dhat", *dhat_m), **other)  # type: ignore[arg-type]


def bonded_block(draw: Draw, name: str, size: tuple[float, float, float]) -> TetMesh:
    """A gel glued below, its contact face at z = 0, uneven and maybe with slivers."""
    cells = (draw.whole(f"{name} cells", 2, 4), draw.whole(f"{name} cells across", 2, 4), 2)
    mesh = block_mesh(
        cells, size, draw.between(f"{name} jitter", 0, 0.25), draw.seed(f"{name} seed")
    )
    return _maybe_slivers(draw, name, mesh)


def free_block(draw: Draw, name: str, size: tuple[float, float, float]) -> TetMesh:
    """A block about its middle, maybe with slivers."""
    cells = tuple(draw.whole(f"{name} cells {axis}", 1, 3) for axis in "xyz")
    jitter, seed = draw.between(f"{name} jitter", 0, 0.25), draw.seed(f"{name} seed")
    return _maybe_slivers(draw, name, soft_box(cells, size, jitter, seed))  # type: ignore[arg-type]


def free_body(draw: Draw, name: str, size: float) -> TetMesh:
    """A block or a ball about its middle."""
    if draw.chance(f"{name} is a ball", 0.4):
        return soft_ball(size / 2, draw.whole(f"{name} cells", 2, 3))
    return free_block(draw, name, (size, size, size))


def thrown_body(
    draw: Draw, name: str, mesh: TetMesh, at: np.ndarray, velocity_m_s: tuple[float, float, float]
) -> SoftBody:
    """A soft body that flies."""
    return SoftBody(
        mesh,
        material(draw, name),
        FREE,
        name=name,
        element=draw.choose(f"{name} element", ELEMENTS),
        friction_coefficient=friction(draw, f"friction of {name}"),
        initial_pose=at,
        initial_velocity_m_s=velocity_m_s,
    )


def _maybe_slivers(draw: Draw, name: str, mesh: TetMesh) -> TetMesh:
    if not draw.chance(f"{name} has slivers", 0.3):
        return mesh
    left = draw.decades(f"{name} volume left in slivers", 1e-5, 1e-1)
    return with_slivers(mesh, left, 0.3, draw.seed(f"{name} sliver seed"))
