# SPDX-License-Identifier: Apache-2.0
"""How an object stands over the gel, and the press that a touch is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.cad.parts.pad import Pad
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.geometry import PixelGrid
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import Indenter, PressPath, PressPhysics, PressSetup
from taccel_lab.presses.frame import face_frame
from taccel_lab.scene import Ball, TriangleMesh
from taccel_lab.signals.frame_faults import FrameFaults
from taccel_lab.signals.perturbation import Perturbation


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
        base, turn = face_frame(pad, self.at_mm), self.turn()
        axis = rotate(turn, np.array([0.0, 0.0, 1.0]))
        back = -_height_m(indenter, turn) / axis[2] * np.append(axis[:2], 0.0)
        return np.concatenate([base[:3] + rotate(base[3:], back), _product(base[3:], turn)])

    def setup(
        self,
        sensor: Sensor,
        indenter: Indenter,
        path: PressPath,
        physics: PressPhysics,
        *,
        friction: float,
        poisson_ratio: float | None = None,
        focused: bool = True,
        device: str = "cpu",
    ) -> PressSetup:
        """The gel and the object, meshed as for any press along its path.

        Args:
            sensor: What is touched.
            indenter: The object.
            path: Its way, in its own frame.
            physics: Grade of the press.
            friction: Coefficient between the two.
            poisson_ratio: Ratio in place of the sensor's own.
            focused: Whether the gel is meshed for the press; else its mesh is the sensor's own.
            device: Warp device.

        Raises:
            InputError: A place or way where the pad cannot be meshed.
        """
        ratio = sensor.poisson_ratio if poisson_ratio is None else poisson_ratio
        if not focused:
            own = physics.of_press(path.depth_mm, friction, ratio, in_batch=True)
            material = sensor.material_of(sensor.mesh)
            return PressSetup(sensor.mesh, material, indenter, friction, own, device)
        turn = self.turn()
        # Digits that a turn adds may lead past what a path may be.
        shear, roll = (
            tuple(np.round(rotate(turn, np.array([*along, 0.0]))[:2], 9).tolist())
            for along in (path.shear_mm, path.roll_deg)
        )
        setup = PressSetup.on_pad(
            sensor.pad,
            sensor.material_of,
            turned(indenter, turn),
            self.at_mm,
            replace(path, shear_mm=shear, roll_deg=roll),
            poisson_ratio=ratio,
            friction_coefficient=friction,
            physics=physics,
            device=device,
            in_batch=True,
        )
        return replace(setup, indenter=indenter)


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
    setup: PressSetup
    """The gel on its mesh, with the sensor's own material, the object and their friction."""
    frame: np.ndarray
    """gel_from_press, [7]."""
    commands: np.ndarray
    """Columns ``presses.path.COMMAND``, in the object's frame at the start, [step, 6]."""
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
