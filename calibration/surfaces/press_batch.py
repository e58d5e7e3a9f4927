# SPDX-License-Identifier: Apache-2.0
"""Some presses simulated together: what they need, and where they end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from taccel_lab.calibration.surfaces.depth_search import DepthSearch

from taccel_lab.calibration.capture import CaptureSet
from taccel_lab.calibration.surfaces.press_surface import PressSurface, SimulationEffort
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.profile import MaterialBlock
from taccel_lab.sensors.press_mesh import Pad, pad_press_mesh

if TYPE_CHECKING:
    from taccel_lab.presses import Indenter, PressEnv
    from taccel_lab.signals.rest_surface import RestSurface
    from taccel_lab.solvers import StepReport

RADIUS_TOLERANCE_PX = 0.25
"""How near the simulated contact radius must come to the circle's."""
STEP_MM = 0.35
"""Largest change of depth in a step with friction: sliding depends on the path."""
FREE_STEP_MM = math.inf
"""The same without: one step ends where many do, within a micrometre, in half the iterations."""


@dataclass(frozen=True)
class PressBatch:
    """What one process needs; plain data."""

    presses: tuple[int, ...]
    """Indices of the presses among the captures'."""
    at_mm: np.ndarray
    """Gel xy of the contacts [mm], shape [press, 2]."""
    target_mm: np.ndarray
    """Contact radii [mm], shape [press]."""
    tolerance_mm: float
    ball_radius_mm: float
    pad: Pad
    material: MaterialBlock
    friction: float
    physics: PressPhysics

    def recipe(self) -> dict[str, Any]:
        """Everything that the outcome depends on, for the key that it is kept under."""
        left_out = {"provenance", "friction_coefficient"}
        return {
            "at_mm": self.at_mm,
            "target_mm": self.target_mm,
            "tolerance_mm": self.tolerance_mm,
            "ball_radius_mm": self.ball_radius_mm,
            "pad": repr(self.pad),
            "material": self.material.model_dump(mode="json", exclude=left_out),
            "friction": self.friction,
            "physics": self.physics.record(),
        }

    def meshes(self) -> list[TetMesh]:
        """The gel of each press, at rest."""
        return [
            pad_press_mesh(self.pad, (float(x), float(y)), float(radius), self.physics.mesh)
            for (x, y), radius in zip(self.at_mm, self.target_mm, strict=True)
        ]


@dataclass(frozen=True)
class BatchOutcome:
    """Where the presses of a batch ended; arrays of which the first axis is the press."""

    positions_m: np.ndarray
    """Nodes of the gel [m], shape [press, node, 3]."""
    ball_m: np.ndarray
    """Middle of the ball in the gel frame [m], shape [press, 3]."""
    radius_mm: np.ndarray
    depth_mm: np.ndarray
    force_n: np.ndarray
    residual_n: np.ndarray
    newton_iterations: np.ndarray
    min_distance_m: np.ndarray
    seconds_per_step: np.ndarray
    step_count: np.ndarray


def simulate_batch(batch: PressBatch) -> BatchOutcome:
    """Press until the contacts have their radii; runs in a process of its own."""
    import warp as wp

    from taccel_lab.presses.press_surface import contact_radii_m

    wp.config.log_level = wp.LOG_ERROR
    count = len(batch.at_mm)
    env, ball = _env(batch)
    # What is matched with a circle is what touches. One might match what is seen, where the gel is
    # still within some micrometres of the ball, and press less deeply. At a gap of 20 um, 0.1 mm
    # further out, colours of left-out training presses are predicted worse on two sensors and no
    # better than by chance on the third (docs/ablations.md).
    window, frames = _window(1.4 * batch.ball_radius_mm), np.zeros((count, 7))
    frames[:, :2], frames[:, 6] = 1e-3 * batch.at_mm, 1.0
    search = DepthSearch(batch.target_mm, batch.ball_radius_mm, batch.tolerance_mm)
    reports: list[StepReport] = []
    while True:
        reports += _press(env, search.depth_mm, STEP_MM if batch.friction > 0 else FREE_STEP_MM)
        if search.update(1e3 * contact_radii_m(env, ball, window, frames, points=2)):
            break
    seconds = float(np.mean([r.seconds for r in reports]) / count)
    return BatchOutcome(
        positions_m=env.positions.copy(),
        ball_m=env.poses[:, 0, :3].copy(),
        radius_mm=search.radius_mm,
        depth_mm=search.depth_mm,
        force_n=env.wrench[:, 2].copy(),
        residual_n=np.asarray(reports[-1].residual_n, dtype=np.float64),
        newton_iterations=np.sum([r.newton_iterations for r in reports], axis=0),
        min_distance_m=np.min([r.min_distance_m for r in reports], axis=0),
        seconds_per_step=np.full(count, seconds),
        step_count=np.full(count, len(reports)),
    )


def surfaces_of(
    batch: PressBatch, outcome: BatchOutcome, captures: CaptureSet, designed_rest: RestSurface
) -> list[PressSurface]:
    """The surfaces on the pixels of the images; ``designed_rest`` is the face at rest there.

    Pixels of no use that the pad leaves are as the nearest that it covers; InputError where it
    leaves pixels that are used.

    In contact they are the ball's: nodes hover in the barrier's range, corners and middles of faces
    at heights of their own, and a surface through them is bumpy by 2 to 3 degrees under deep
    presses, which no image shows.
    """
    from taccel_lab.presses.press_surface import press_surface
    from taccel_lab.signals.rest_surface import from_nearest

    env, ball = _env(batch)
    poses = np.zeros((len(batch.at_mm), 7))
    poses[:, :3], poses[:, 6] = outcome.ball_m, 1.0
    env.restore(outcome.positions_m, poses)
    surfaces, grid = [], captures.grid
    for i, press in enumerate(batch.presses):
        seen = press_surface(env, ball, grid, designed_rest, i)
        faces = (seen.height_m, seen.rest_height_m, seen.normals, seen.rest_normals)
        covered = np.all(np.isfinite(np.dstack(faces)), axis=-1)
        lost = int((captures.mask & ~covered).sum())
        if lost:
            raise InputError(
                f"{captures.source}: {captures.presses[press].name}: pressed like this, the pad "
                f"leaves {lost} pixels of the image; press farther from its edge, or mask them"
            )
        height_m, rest_height_m, normals, rest_normals = from_nearest(covered, *faces)
        surfaces.append(
            PressSurface(
                height_m=height_m,
                rest_height_m=rest_height_m,
                normals=normals,
                rest_normals=rest_normals,
                contact_radius_px=float(outcome.radius_mm[i] / grid.mm_per_px_x),
                depth_mm=float(outcome.depth_mm[i]),
                force_n=float(outcome.force_n[i]),
                residual_n=float(outcome.residual_n[i]),
                provider=f"finite elements, friction {batch.friction:g}",
                effort=SimulationEffort(
                    step_count=int(outcome.step_count[i]),
                    newton_iterations=int(outcome.newton_iterations[i]),
                    seconds_per_step=float(outcome.seconds_per_step[i]),
                    min_distance_m=float(outcome.min_distance_m[i]),
                ),
            )
        )
    return surfaces


def _press(env: PressEnv, depth_mm: np.ndarray, step_mm: float) -> list[StepReport]:
    """Go to the depths in steps of at most ``step_mm``."""
    now = env.depth_m * 1e3
    count = max(1, math.ceil(np.abs(depth_mm - now).max() / step_mm))
    return [env.move_to(now + (depth_mm - now) * (i + 1) / count) for i in range(count)]


def _window(reach_mm: float) -> PixelGrid:
    """A small grid about a press, on which to measure its contact."""
    return PixelGrid(121, 121, reach_mm / 60, reach_mm / 60)


def _env(batch: PressBatch) -> tuple[PressEnv, Indenter]:
    """The presses before they begin, and the ball."""
    from taccel_lab.presses import Indenter, PressEnv, profile_material
    from taccel_lab.scene import Ball

    meshes = batch.meshes()
    ball = Indenter(f"sphere:{batch.ball_radius_mm:g}", Ball(batch.ball_radius_mm * 1e-3))
    env = PressEnv(
        meshes[0],
        profile_material(batch.material, meshes[0]),
        ball,
        batch.at_mm,
        friction_coefficient=batch.friction,
        rest_positions_m=np.stack([mesh.nodes_m for mesh in meshes]),
        physics=batch.physics,
    )
    return env, ball
