# SPDX-License-Identifier: Apache-2.0
"""The gel surface under each captured press, from a finite-element simulation of that press.

A ball goes down on the designed pad where the capture's contact circle lies, until the simulated
contact has the circle's radius. The depth is not known from the image: it is found by a secant
search on the contact radius, all presses of a batch at once. How the gel sinks around the contact,
which no closed form gives for a layer of finite thickness, comes out of the simulation.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TYPE_CHECKING

import numpy as np

from calibration.capture import CaptureSet, ContactCircle
from calibration.surfaces.types import PressSurface, SimulationEffort
from sensors.press_mesh import PressMeshOptions, press_mesh
from sensors.registry import sensor_family
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.profile import SensorProfile
from taccel_lab.scene import Material

if TYPE_CHECKING:
    from taccel_lab.envs import PressEnv
    from taccel_lab.solvers import StepReport

BATCH = 6
"""Presses simulated together in one process."""
MAX_ROUNDS = 6
"""Depths tried for each press."""
RADIUS_TOLERANCE_PX = 0.25
"""How near the simulated contact radius must come to the circle's."""
FIRST_DEPTH_PER_CAP = 1.45
"""Depth over the height of the cap of that contact radius, to start the search: of a half-space
1.5 to 2, of a press as deep as the ball's radius about 1.4."""
STEP_MM = 0.35
"""Largest change of depth in a step."""
DEEPEST_RADII = 1.2
"""The search does not go deeper than this many ball radii: beyond, the contact closes in under the
ball and its radius no longer grows."""


@dataclass(frozen=True)
class _Batch:
    """What one process needs; plain data."""

    first: int
    circles: tuple[ContactCircle, ...]
    grid: PixelGrid
    ball_radius_mm: float
    family: str
    parameters: dict
    material: Material
    friction: float
    mesh: PressMeshOptions


def simulate_presses(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    profile: SensorProfile,
    *,
    mesh: PressMeshOptions | None = None,
    friction_coefficient: float = 0.0,
    processes: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[PressSurface]:
    """Simulate all presses of ``captures`` and return their surfaces in order.

    Args:
        captures: Ball radius, pixel grid and names.
        circles: Contact circle of each press [px].
        profile: The designed sensor: family, parameters and material.
        mesh: Resolution; the defaults resolve a 2 mm ball.
        friction_coefficient: Between ball and gel. Frictionless presses fit best what the images
            of real ball presses show: the slope beside the contact that they imply falls off as
            without friction (docs/captures.md).
        processes: Worker processes; the number of cores, at most 8, when None.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A circle that the ball cannot make.
        SimulationError: A press that did not converge.
    """
    if len(circles) != len(captures.presses):
        raise InputError(f"{len(circles)} contact circles for {len(captures.presses)} presses")
    radius_mm = captures.ball_radius_mm
    for press, circle in zip(captures.presses, circles, strict=True):
        contact_mm = circle.radius_px * captures.grid.mm_per_px_x
        if contact_mm >= radius_mm:
            raise InputError(
                f"{captures.source}: press {press.name!r} has a contact radius of "
                f"{contact_mm:.3f} mm, which a ball of radius {radius_mm:g} mm cannot make; check "
                "the scale and the ball's radius"
            )
    _require_view_on_pad(captures, profile)
    material = profile.material
    batches = [
        _Batch(
            first=start,
            circles=tuple(circles[start : start + BATCH]),
            grid=captures.grid,
            ball_radius_mm=radius_mm,
            family=profile.sensor.family,
            parameters=dict(profile.sensor.parameters),
            material=Material(
                material.young_modulus_pa, material.poisson_ratio, material.density_kg_m3
            ),
            friction=friction_coefficient,
            mesh=mesh or PressMeshOptions(),
        )
        for start in range(0, len(circles), BATCH)
    ]
    surfaces: list[PressSurface | None] = [None] * len(circles)

    def keep(batch: _Batch, found: list[PressSurface]) -> None:
        surfaces[batch.first : batch.first + len(found)] = found
        if progress is not None:
            progress(sum(s is not None for s in surfaces), len(surfaces))

    workers = min(processes or min(os.cpu_count() or 1, 8), len(batches))
    if workers == 1:
        for batch in batches:
            keep(batch, _simulate_batch(batch))
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            futures = {pool.submit(_simulate_batch, batch): batch for batch in batches}
            try:
                for future in as_completed(futures):
                    keep(futures[future], future.result())
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [surface for surface in surfaces if surface is not None]


def _require_view_on_pad(captures: CaptureSet, profile: SensorProfile) -> None:
    """Refuse captures that show more than the pad: there is no surface under those pixels."""
    grid, family = captures.grid, sensor_family(profile.sensor.family)
    pad = family.pad(family.parameters(profile.sensor.parameters))
    last = np.array([grid.width_px - 1, grid.height_px - 1])
    corners = grid.gel_from_pixel(np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * last)
    if pad.inside_distance_mm(corners).min() < 0:
        width_mm, height_mm = last * (grid.mm_per_px_x, grid.mm_per_px_y)
        size_x_mm, size_y_mm = np.diff(pad.bounds_mm()[:, :2], axis=0)[0]
        raise InputError(
            f"{captures.source}: at {grid.mm_per_px_x:g} x {grid.mm_per_px_y:g} mm/px the image "
            f"shows {width_mm:.1f} x {height_mm:.1f} mm, more than the pad of {size_x_mm:g} x "
            f"{size_y_mm:g} mm; check the scale, or design a larger pad"
        )


def _simulate_batch(batch: _Batch) -> list[PressSurface]:
    """Simulate the presses of a batch; runs in a process of its own."""
    import warp as wp

    from taccel_lab.envs import Indenter, PressEnv
    from taccel_lab.scene import Ball
    from taccel_lab.signals import SignalHeightMap

    wp.config.log_level = wp.LOG_WARNING
    grid, ball_mm = batch.grid, batch.ball_radius_mm
    scale = grid.mm_per_px_x
    at_mm = grid.gel_from_pixel(np.array([[c.u_px, c.v_px] for c in batch.circles]))
    target_mm = np.array([c.radius_px for c in batch.circles]) * scale
    meshes = [
        press_mesh(batch.family, batch.parameters, (float(x), float(y)), float(radius), batch.mesh)
        for (x, y), radius in zip(at_mm, target_mm, strict=True)
    ]
    env = PressEnv(
        meshes[0],
        batch.material,
        Indenter(f"sphere:{ball_mm:g}", Ball(ball_mm * 1e-3)),
        at_mm,
        friction_coefficient=batch.friction,
        rest_positions_m=np.stack([mesh.nodes_m for mesh in meshes]),
    )
    search = _DepthSearch(target_mm, ball_mm, RADIUS_TOLERANCE_PX * scale)
    reach_mm = 1.4 * ball_mm
    reports: list[StepReport] = []
    while True:
        reports += _press(env, search.depth_mm)
        radii = [
            _contact_radius_mm(env, i, meshes[i], _window(at_mm[i], reach_mm), ball_mm)
            for i in range(len(meshes))
        ]
        if search.update(np.array(radii)):
            break
    surfaces = []
    forces, positions = env.wrench, env.positions.copy()
    for i, mesh in enumerate(meshes):
        signal = SignalHeightMap(mesh, grid)
        signal.update(np.stack([mesh.nodes_m, positions[i]]))
        (rest_height, height), (rest_normals, normals) = signal.height_m, signal.normals
        surfaces.append(
            PressSurface(
                height_m=height,
                rest_height_m=rest_height,
                normals=normals,
                rest_normals=rest_normals,
                contact_radius_px=float(search.radius_mm[i] / scale),
                depth_mm=float(search.depth_mm[i]),
                force_n=float(forces[i, 2]),
                residual_n=float(reports[-1].residual_n[i]),
                provider=f"finite elements, friction {batch.friction:g}",
                effort=SimulationEffort(
                    step_count=len(reports),
                    newton_iterations=int(sum(r.newton_iterations[i] for r in reports)),
                    seconds_per_step=float(
                        np.mean([r.seconds for r in reports]) / len(batch.circles)
                    ),
                    min_distance_m=float(min(r.min_distance_m[i] for r in reports)),
                ),
            )
        )
    return surfaces


def _press(env: PressEnv, depth_mm: np.ndarray) -> list[StepReport]:
    """Go to the depths in steps, since sliding with friction depends on the path."""
    now = (env.touch_m - env.poses[:, 0, 2]) * 1e3
    count = max(1, math.ceil(np.abs(depth_mm - now).max() / STEP_MM))
    return [env.move_to(now + (depth_mm - now) * (i + 1) / count) for i in range(count)]


class _DepthSearch:
    """Secant search for the depths at which the contact radii meet their targets."""

    def __init__(self, target_mm: np.ndarray, ball_mm: float, tolerance_mm: float) -> None:
        self.target_mm = target_mm
        self.tolerance_mm = tolerance_mm
        below = np.sqrt(ball_mm**2 - target_mm**2)
        self._limit_mm = DEEPEST_RADII * ball_mm
        self.depth_mm = np.minimum(FIRST_DEPTH_PER_CAP * (ball_mm - below), self._limit_mm)
        # Slope of depth over radius of the same rule, until two points give a better one.
        self._rule_slope = FIRST_DEPTH_PER_CAP * target_mm / below
        self._slope = self._rule_slope
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._rounds = 0
        self.radius_mm = np.zeros_like(target_mm)
        """Contact radii at the latest depths [mm]."""

    def update(self, radius_mm: np.ndarray) -> bool:
        """Take the radii found at ``depth_mm`` and set the next; True when all are met."""
        self._rounds += 1
        self.radius_mm = radius_mm
        error = self.target_mm - radius_mm
        done = np.abs(error) <= self.tolerance_mm
        if done.all() or self._rounds >= MAX_ROUNDS:
            return True
        if self._last is not None:
            step_depth, step_radius = self.depth_mm - self._last[0], radius_mm - self._last[1]
            # A measured radius carries noise of about the tolerance: between points that close the
            # secant is noise, and so is one far from the rule.
            usable = np.abs(step_radius) > 3 * self.tolerance_mm
            secant = step_depth / np.where(usable, step_radius, 1.0)
            good = usable & (secant > 0.3 * self._rule_slope) & (secant < 3 * self._rule_slope)
            self._slope = np.where(good, secant, self._slope)
        self._last = (self.depth_mm.copy(), radius_mm.copy())
        change = np.where(done, 0.0, self._slope * error)
        change = np.clip(change, -0.3 * self.depth_mm, 0.5 * self.depth_mm)
        self.depth_mm = np.clip(self.depth_mm + change, 0.0, self._limit_mm)
        return False


def _window(at_mm: np.ndarray, reach_mm: float) -> PixelGrid:
    """A small grid about a press, on which to measure its contact."""
    size, step = 121, 2 * reach_mm / 120
    middle = (size - 1) / 2
    return PixelGrid(
        size, size, step, step, middle - float(at_mm[0]) / step, middle - float(at_mm[1]) / step
    )


def _contact_radius_mm(
    env: PressEnv, index: int, mesh: TetMesh, window: PixelGrid, ball_mm: float
) -> float:
    from taccel_lab.signals import SignalFusedSurface, SphereSurface

    signal = SignalFusedSurface(mesh, window, contact_gap_m=env.solver.config.dhat_m)
    sphere = SphereSurface(env.poses[index, 0, :3], ball_mm * 1e-3, window)
    signal.update(env.positions[index : index + 1], sphere)
    return float(signal.contact_radius_m[0] * 1e3)
