# SPDX-License-Identifier: Apache-2.0
"""What a case of the stress is: parameters drawn from a seed, each kept by name for the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar
from zlib import crc32

import numpy as np

from taccel_lab.benchmarks.stress.shapes import soft_ball, soft_box, with_slivers
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    MaterialModel,
    Scene,
    SoftBody,
    TimeScheme,
    TimeStepping,
    TriangleMesh,
)
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State

Option = TypeVar("Option")


class Draw:
    """Draws of one case. The same family and seed give the same values in every run."""

    def __init__(self, family: str, seed: int) -> None:
        self._random = np.random.default_rng([crc32(family.encode()), seed])
        self.values: dict[str, Any] = {}
        """What was drawn, in order."""

    def _keep(self, name: str, value: Any) -> Any:
        if name in self.values:
            raise ValueError(f"{name!r} is drawn twice")
        self.values[name] = value
        return value

    def between(self, name: str, low: float, high: float) -> float:
        """Evenly from low to high."""
        return self._keep(name, float(self._random.uniform(low, high)))

    def decades(self, name: str, low: float, high: float) -> float:
        """Evenly in the logarithm."""
        exponent = self._random.uniform(np.log10(low), np.log10(high))
        return self._keep(name, float(10.0**exponent))

    def whole(self, name: str, low: int, high: int) -> int:
        """A whole number, both ends included."""
        return self._keep(name, int(self._random.integers(low, high + 1)))

    def choose(self, name: str, options: Sequence[Option]) -> Option:
        """One of a few things, which print well."""
        return self._keep(name, options[int(self._random.integers(len(options)))])

    def chance(self, name: str, probability: float) -> bool:
        """True in that part of all seeds."""
        return self._keep(name, bool(self._random.uniform() < probability))

    def direction(self, name: str, size: int = 3) -> np.ndarray:
        """A unit vector, shape [size]; kept as rounded text, as what the seed gives is long."""
        vector = self._random.normal(size=size)
        vector /= np.linalg.norm(vector)
        self._keep(name, " ".join(f"{value:.3f}" for value in vector))
        return vector

    def rotation(self, name: str) -> np.ndarray:
        """A unit quaternion x, y, z, w."""
        return self.direction(name, 4)

    def seed(self, name: str) -> int:
        """A seed for somebody else's random numbers."""
        return self.whole(name, 0, 2**31 - 1)


@dataclass(frozen=True)
class StressCase:
    """A scene, and what happens to it."""

    scene: Scene
    config: SolverConfig
    steps: int
    start: np.ndarray | None = None
    """Poses of the kinematic bodies at the start, [env_count, kinematic_count, 7]."""
    targets: Callable[[int], np.ndarray] | None = None
    """Poses at the end of step 0, 1, ...; where they are when None."""
    prepare: Callable[[SolverIPC, State, int], None] | None = None
    """Called before each step: sets loads or the targets of drives."""
    expect: Callable[[Model, State, int], str | None] | None = None
    """A referee of the family itself: says what is wrong after step 0, 1, ..., or None."""
    possible: bool = True
    """Whether every step has an answer; where not, a step that fails with a cause is right."""
    closed: bool = False
    """Nothing does work on the bodies: with implicit Euler their energy must not rise."""

    @classmethod
    def along(
        cls, path: Sequence[np.ndarray], scene: Scene, config: SolverConfig, possible: bool = True
    ) -> StressCase:
        """Kinematic bodies go along a path of poses [kinematic_count, 7], [7] of a single one: the
        start, and the target of each step."""
        poses = [place.reshape(1, -1, 7) for place in path]
        case = cls(scene, config, len(poses) - 1, poses[0], lambda i: poses[i + 1])
        return replace(case, possible=possible)

    @property
    def watches_energy(self) -> bool:
        """Whether a rise of the energy is a fault."""
        return self.closed and self.scene.time.scheme is TimeScheme.EULER


FREE = np.zeros(0, dtype=np.int64)
"""No bonded node."""
Range = tuple[float, float]
Vector = tuple[float, float, float]
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
    young, heavy = (
        draw.decades(f"{name} young", *young_pa),
        draw.decades(f"{name} density", *density),
    )
    return Material(young, nu, heavy, law, ratio)


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


def soft_body(
    draw: Draw,
    mesh: TetMesh,
    held: np.ndarray | None = None,
    young_pa: Range = (1e3, 1e9),
    density: Range = (100.0, 1e4),
    stuff: str = "material",
) -> SoftBody:
    """A body of any element; ``held``: bonded nodes, those of the mesh when None."""
    of = material(draw, stuff, young_pa, density)
    return SoftBody(mesh, of, held, element=draw.choose("element", ELEMENTS))


def glued_gel(draw: Draw, size: Vector, rubs: str = "friction", **drawn: Any) -> SoftBody:
    """A gel glued below; ``rubs``: what its friction is drawn as; ``drawn``: of ``soft_body``."""
    gel = soft_body(draw, bonded_block(draw, "gel", size), **{"stuff": "gel", **drawn})
    return replace(gel, friction_coefficient=friction(draw, rubs))


def stiff_body(
    shape: TriangleMesh,
    density: float,
    mu: float,
    at: np.ndarray | None = None,
    velocity: Vector = (0.0, 0.0, 0.0),
    spin: Vector = (0.0, 0.0, 0.0),
    young_pa: float = 1e9,
    name: str = "body",
) -> AffineBody:
    """A free body at a pose; velocity [m/s] and spin [rad/s]."""
    body = AffineBody(shape, density, young_pa, name, mu, initial_pose=at)
    return replace(body, initial_velocity_m_s=velocity, initial_spin_rad_s=spin)


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
    body = SoftBody(mesh, material(draw, name), FREE, name=name)
    body = replace(body, element=draw.choose(f"{name} element", ELEMENTS), initial_pose=at)
    mu = friction(draw, f"friction of {name}")
    return replace(body, friction_coefficient=mu, initial_velocity_m_s=velocity_m_s)


def _maybe_slivers(draw: Draw, name: str, mesh: TetMesh) -> TetMesh:
    if not draw.chance(f"{name} has slivers", 0.3):
        return mesh
    left = draw.decades(f"{name} volume left in slivers", 1e-5, 1e-1)
    return with_slivers(mesh, left, 0.3, draw.seed(f"{name} sliver seed"))
