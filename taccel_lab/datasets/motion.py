# SPDX-License-Identifier: Apache-2.0
"""How an object stands over the gel, the mesh of the gel for that, and where it goes by steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import Indenter, normal_frame
from taccel_lab.presses.mesh import pad_press_mesh
from taccel_lab.presses.mesh_options import PressMeshOptions
from taccel_lab.scene import Ball, TriangleMesh
from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.signals.perturbation import Perturbation

COMMAND = ("depth_mm", "shear_x_mm", "shear_y_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")
"""Columns of what is asked of a step, in the object's frame at the start: depth past first touch,
motion along the face, rotation vector. A roll moves the object on besides (``rolled_mm``)."""


@dataclass(frozen=True)
class TouchMotion:
    """Down to a depth, then sideways, about the axis or rolling, in equal steps."""

    kind: str
    depth_mm: float
    shear_mm: float = 0.0
    direction_deg: float = 0.0
    """Direction of shear and roll, from the object's x towards its y."""
    twist_deg: float = 0.0
    roll_deg: float = 0.0
    step_mm: float = 0.2
    step_deg: float = 2.0

    @property
    def down_count(self) -> int:
        """Steps down."""
        return max(1, math.ceil(self.depth_mm / self.step_mm - 1e-9))

    @property
    def step_count(self) -> int:
        side = (
            self.shear_mm / self.step_mm,
            abs(self.twist_deg) / self.step_deg,
            abs(self.roll_deg) / self.step_deg,
        )
        return self.down_count + math.ceil(max(side) - 1e-9)

    def commands(self) -> np.ndarray:
        """What is asked of each step, columns ``COMMAND``, [step, 6]."""
        down = self.down_count
        count = self.step_count
        there = np.zeros((count, 6))
        there[:, 0] = self.depth_mm * np.minimum(np.arange(1, count + 1) / down, 1.0)
        side = np.arange(1, count - down + 1) / max(count - down, 1)
        direction_rad = math.radians(self.direction_deg)
        along, across = (
            np.array([math.cos(direction_rad), math.sin(direction_rad)]),
            np.array([-math.sin(direction_rad), math.cos(direction_rad)]),
        )
        there[down:, 1:3] = side[:, None] * self.shear_mm * along
        there[down:, 3:5] = side[:, None] * self.roll_deg * across
        there[down:, 5] = side * self.twist_deg
        return there


def rolled_mm(commands: np.ndarray, height_mm: np.ndarray) -> np.ndarray:
    """How far objects whose origins are ``height_mm`` [n] above the face have rolled on by their
    turns, [n, 2]: height times angle, as without sliding; ``commands`` is [n, 6]."""
    turn = np.radians(commands[:, 3:5])
    return height_mm[:, None] * np.column_stack([turn[:, 1], -turn[:, 0]])


@dataclass(frozen=True)
class Placing:
    """Place and attitude of an object."""

    x_mm: float
    y_mm: float
    yaw_deg: float = 0.0
    tilt_deg: float = 0.0
    """Tilt of its axis, along which it comes down, from the face's normal."""
    lean_deg: float = 0.0
    """Side to which the axis leans, from x towards y."""

    @property
    def at_mm(self) -> tuple[float, float]:
        return self.x_mm, self.y_mm

    def turn(self) -> np.ndarray:
        """Attitude over a face whose normal is z, quaternion x, y, z, w."""
        lean, tilt, yaw = (math.radians(a) for a in (self.lean_deg, self.tilt_deg, self.yaw_deg))
        s, c = math.sin(tilt / 2), math.cos(tilt / 2)
        leaning = np.array([-math.sin(lean) * s, math.cos(lean) * s, 0.0, c])
        return _product(leaning, np.array([0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]))

    def frame(self, pad: Pad, indenter: Indenter) -> np.ndarray:
        """gel_from_press, [7]: the object's origin is above the place when it touches.

        Raises InputError for a place beside the pad."""
        xy = np.array(self.at_mm)
        top, normal = float(pad.top_mm(xy)), pad.top_normal(xy)
        if not (math.isfinite(top) and np.isfinite(normal).all()):
            raise InputError(f"({xy[0]:.3g}, {xy[1]:.3g}) mm lies beside the contact face")
        base = normal_frame(np.append(xy, top) * 1e-3, normal)
        turn = self.turn()
        axis = rotate(turn, np.array([0.0, 0.0, 1.0]))
        back = -_height_m(indenter, turn) / axis[2] * np.append(axis[:2], 0.0)
        return np.concatenate([base[:3] + rotate(base[3:], back), _product(base[3:], turn)])

    def mesh(
        self, pad: Pad, indenter: Indenter, depth_mm: float, options: PressMeshOptions
    ) -> TetMesh:
        """The gel, graded as for any press around what the object touches."""
        return pad_press_mesh(
            pad, self.at_mm, turned(indenter, self.turn()).contact(depth_mm), options
        )


def turned(indenter: Indenter, turn: np.ndarray) -> Indenter:
    """The same object in another attitude."""
    shape = indenter.shape
    if isinstance(shape, Ball):
        return indenter
    return replace(indenter, shape=TriangleMesh(rotate(turn, shape.vertices_m), shape.faces))


def view_range_mm(grid: PixelGrid, view: float) -> tuple[np.ndarray, np.ndarray]:
    """Gel xy [mm] of the corners of the part ``view`` of an image about its middle, low and
    high, [2]."""
    half = 0.5 * np.array([grid.width_px - 1, grid.height_px - 1])
    return grid.gel_from_pixel(half - view * half), grid.gel_from_pixel(half + view * half)


def _height_m(indenter: Indenter, turn: np.ndarray) -> float:
    """Height of the object's origin over its lowest point."""
    shape = indenter.shape
    if isinstance(shape, Ball):
        return shape.radius_m
    return float(-rotate(turn, shape.vertices_m)[:, 2].min())


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions x, y, z, w."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.append(vector, a[3] * b[3] - a[:3] @ b[:3])


@dataclass(frozen=True, eq=False)
class Touch:
    """One episode, ready to be simulated."""

    episode: int
    mesh: TetMesh
    frame: np.ndarray
    """gel_from_press, [7]."""
    commands: np.ndarray
    """Columns ``motion.COMMAND``, [step, 6]."""
    friction: float
    unit: int = 0
    young_modulus_factor: float = 1.0
    light: Perturbation | None = None
    noise_levels: float = 0.0
    marker_noise_px: float = 0.0
    seed: tuple[int, ...] = (0,)
    """Seed of the noise."""
    faults: FrameFaults | None = None
    """What can be wrong with its images."""
    fault_seed: int = 0

    def rng(self, step: int, what: int) -> np.random.Generator:
        """Source of the noise of one step."""
        return np.random.default_rng([*self.seed, self.episode, step, what])


@dataclass(frozen=True, eq=False)
class TouchRecord:
    """What is kept of a touch."""

    episode: int
    rows: dict[str, np.ndarray]
    """Rows by channel, [step + 1, ...]: the untouched gel, then each step that converged."""
    wanted: int
    """Steps of the motion."""
    cause: str
    """Why there are fewer; empty when all converged."""
    gel_from_press: np.ndarray
    nodes_m: np.ndarray
    """Contact face at rest, [node, 3]."""
    faces: np.ndarray
    """Its triangles, [face, 3]."""


def failed_touch(episode: int, wanted: int, cause: str) -> TouchRecord:
    """The record of a touch that could not be set up."""
    nothing = np.zeros((0, 3))
    return TouchRecord(
        episode, {}, wanted, cause, np.full(7, np.nan), nothing, nothing.astype(np.int32)
    )
