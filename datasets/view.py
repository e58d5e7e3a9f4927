# SPDX-License-Identifier: Apache-2.0
"""What a step of some environments led to: read once, when a channel asks for it.

Rows are environments of ``who``, in order. What lies on the device is read there for all of them
together; surfaces that show the object itself (``SignalFusedSurface``) are made one by one on the
host.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.datasets.sensor import Sensor, resized_grid
from taccel_lab.datasets.touch import Touch
from taccel_lab.envs.press import PressEnv, PressError
from taccel_lab.envs.press_surface import points_across_pixel
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.optics.render import OpticalModel
from taccel_lab.outputs import Outputs
from taccel_lab.outputs.surface_load import SurfaceLoad
from taccel_lab.scene import Ball
from taccel_lab.signals import HeightFieldSurface, SignalFusedSurface, SphereSurface
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.perturbation import Perturbation
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.signals.tactile_image import DeviceColorModel
from taccel_lab.solvers import StepReport

COARSE_PX = 160
"""Width of the image that a contact's area is measured on where no image shows the contact."""


class View:
    """One batch of touches; ``at`` points it at what a step led to."""

    def __init__(
        self,
        env: PressEnv,
        touches: Sequence[Touch],
        meshes: Sequence[TetMesh | QuadraticMesh],
        sensor: Sensor,
        *,
        surface: str,
        patches: tuple[int, int],
        channels: Sequence[str],
    ) -> None:
        """``meshes``: of the environments, with all their nodes; ``surface``, ``patches`` and
        ``channels`` as in ``spec.Output``."""
        self.env, self.touches, self.meshes, self.sensor = env, touches, meshes, sensor
        self.surface_kind, self.patches, self.channels = surface, patches, channels
        self._outputs = Outputs(env.solver)
        self.face_nodes = np.unique(env.mesh.region_faces(Region.CONTACT))
        """Nodes of the contact face, [face_node]."""
        self._tactile: dict[PixelGrid, SignalTactile] = {}
        self._fused: dict[tuple[int, PixelGrid, int], SignalFusedSurface] = {}
        self._painters: dict[int, DeviceColorModel] = {}
        self._optical: dict[int, OpticalModel] = {}
        self._layouts: dict[int, MarkerLayout] = {}
        self.who = np.zeros(0, dtype=np.int64)
        self.step = 0
        self.touching = False
        self.report: StepReport | None = None
        self.commands = np.zeros((0, 6))

    def at(
        self, step: int, who: np.ndarray, commands: np.ndarray, report: StepReport | None
    ) -> None:
        """After step ``step`` of the environments ``who`` (int, [row]); step 0 is the gel at rest,
        with no report and no forces. ``commands``: where they were sent, [row, 6]."""
        for name, value in vars(type(self)).items():
            if isinstance(value, cached_property):
                self.__dict__.pop(name, None)
        self.step, self.who, self.commands, self.report = step, who, commands, report
        self.touching = report is not None
        self._outputs.update(self.env.state)

    @property
    def mask(self) -> np.ndarray:
        """The environments, bool, [env_count]."""
        mask = np.zeros(len(self.touches), dtype=bool)
        mask[self.who] = True
        return mask

    @cached_property
    def numbers(self) -> np.ndarray:
        """Episodes of the rows."""
        return np.array([self.touches[env].episode for env in self.who.tolist()])

    # Mechanics -------------------------------------------------------------------------------

    @cached_property
    def positions_m(self) -> np.ndarray:
        """Gel nodes, [row, node, 3]."""
        return self.env.positions[self.who]

    @cached_property
    def tool_poses(self) -> np.ndarray:
        """gel_from_tool, [row, 7]."""
        return self.env.poses[self.who, 0]

    @cached_property
    def forces_n(self) -> np.ndarray:
        """Of the gel's nodes on the object, in the gel frame, [row, node, 3]."""
        if not self.touching:
            return np.zeros_like(self.positions_m)
        return -self.env.contact_forces[self.who]

    @cached_property
    def rubbing_n(self) -> tuple[np.ndarray, np.ndarray]:
        """Magnitudes of the nodes' friction and normal forces, added up, [row] each."""
        if not self.touching:
            return np.zeros(len(self.who)), np.zeros(len(self.who))
        solver, count = self.env.solver, self.env.model.soft_count
        friction, normal = (
            np.linalg.norm(gradient.numpy()[self.who, :count], axis=2).sum(axis=1)
            for gradient in (solver.friction_gradient, solver.contact_gradient)
        )
        return friction, normal

    @cached_property
    def wrench(self) -> np.ndarray:
        """Force [N] and moment about the gel's origin [N m] of the gel on the object, [row, 6]."""
        return resultant_wrench(self.positions_m, self.forces_n)

    @cached_property
    def load(self) -> SurfaceLoad:
        """Pressures and tractions, all environments."""
        return self._outputs.surface_load

    @cached_property
    def pressures_pa(self) -> np.ndarray:
        """Contact pressure at the gel's nodes, [row, node]."""
        if not self.touching:
            return np.zeros(self.positions_m.shape[:2])
        return self.load.pressures.numpy()[self.who, : self.env.model.soft_count]

    @cached_property
    def tractions_pa(self) -> np.ndarray:
        """Force of the gel on the object by area of the gel, [row, node, 3]."""
        if not self.touching:
            return np.zeros_like(self.positions_m)
        return -self.load.tractions.numpy()[self.who, : self.env.model.soft_count]

    @cached_property
    def error(self) -> PressError:
        """Estimated discretisation error, all environments."""
        return self.env.error_estimate(self.mask)

    def errors(self, name: str) -> np.ndarray:
        """One of ``PressError``, [row]; 0 for the untouched gel."""
        if not self.touching:
            return np.zeros(len(self.who))
        return getattr(self.error, name)[self.who]

    @cached_property
    def press_force_n(self) -> np.ndarray:
        """Of the gel on the object in the press frame, [row, 3]."""
        if not self.touching:
            return np.zeros((len(self.who), 3))
        return self.env.press_force[self.who]

    def reported(self, name: str, rest: float) -> np.ndarray:
        """A figure of the step's report, [row]; ``rest`` where there was no step."""
        if self.report is None:
            return np.full(len(self.who), rest)
        return np.asarray(getattr(self.report, name))[self.who]

    # Surfaces --------------------------------------------------------------------------------

    def grid(self, env: int) -> PixelGrid:
        """Pixels of an environment's images."""
        return self.sensor.unit_grid(self.touches[env].unit)

    @cached_property
    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        """Height [m], [row, height_px, width_px], and its slopes [row, height_px, width_px, 2];
        NaN beside the pad."""
        size = (len(self.who), self.sensor.grid.height_px, self.sensor.grid.width_px)
        height, slope = np.empty(size), np.empty((*size, 2))
        for row, env in enumerate(self.who.tolist()):
            if self.surface_kind == "fused":
                fused = self.fused(env)
                height[row], slope[row] = fused.height_m[0], fused.slope[0]
        if self.surface_kind == "gel":
            height = self.tactile("height_m").astype(np.float64)
            normals = self.tactile("normals").astype(np.float64)
            slope = -normals[..., :2] / normals[..., 2:]
        return height, slope

    @cached_property
    def rest_height_m(self) -> np.ndarray:
        """As of ``seen``, of the untouched gel."""
        rests = [self.sensor.rest(self.touches[env].unit) for env in self.who.tolist()]
        return np.stack([rest.height_m for rest in rests])

    @cached_property
    def _fresh(self) -> set[tuple[int, PixelGrid, int]]:
        """Fused surfaces that show this step."""
        return set()

    def fused(self, env: int, coarse: bool = False) -> SignalFusedSurface:
        """Gel and object together in one environment, at this step."""
        grid, shape = self.grid(env), self._shape
        points = 1
        if coarse and grid.width_px > COARSE_PX:
            height = max(2, round(grid.height_px * COARSE_PX / grid.width_px))
            grid = resized_grid(grid, COARSE_PX, height)
        elif not coarse and not isinstance(shape, Ball):
            points = points_across_pixel(grid)
        key = (env, grid, points)
        if key not in self._fused:
            rest = None if coarse else self.sensor.rest(self.touches[env].unit)
            self._fused[key] = SignalFusedSurface(
                self.meshes[env], grid, designed_rest=rest, points=points
            )
        found = self._fused[key]
        if key not in self._fresh:
            self._fresh.add(key)
            row = int(np.searchsorted(self.who, env))
            if isinstance(shape, Ball):
                center = self.tool_poses[row, :3]
                surface: Any = SphereSurface(center, shape.radius_m, found.sample_grid)
            else:
                vertices = self.env.state.positions.numpy()[
                    env : env + 1, self.env.model.soft_count :
                ].copy()
                surface = HeightFieldSurface.from_mesh(vertices, shape.faces, found.sample_grid)
            found.update(self.positions_m[row : row + 1], surface, self.pressures_pa[row : row + 1])
        return found

    @property
    def _shape(self) -> Any:
        return self.env.model.scene.kinematic_bodies[0].shape

    def contacts(self, mask: bool) -> list[SignalFusedSurface]:
        """What shows the contact of each row: with its ``mask`` in the image's pixels, or coarser
        for its area alone."""
        coarse = self.surface_kind == "gel" and not mask
        return [self.fused(env, coarse) for env in self.who.tolist()]

    def tactile(self, name: str) -> np.ndarray:
        """A signal of ``SignalTactile`` by its name, a row each."""
        rows: np.ndarray | None = None
        by_grid: dict[PixelGrid, list[int]] = {}
        for row, env in enumerate(self.who.tolist()):
            by_grid.setdefault(self.grid(env), []).append(row)
        for grid, chosen in by_grid.items():
            if grid not in self._tactile:
                model, background = self.sensor.color or (None, None)
                self._tactile[grid] = SignalTactile.from_solver(
                    self.env.solver, grid, color_model=model, background_rgb=background
                )
            shown = np.zeros(len(self.touches), dtype=bool)
            shown[self.who[chosen]] = True
            signal = self._tactile[grid]
            if grid not in self._pointed:
                self._pointed.add(grid)
                signal.update(self.env.state, who=shown)
            values: np.ndarray = signal.read(name)[0].numpy()
            if name in CONTACT_SIGNALS and not self.touching:
                # The solver's last forces are those of an earlier batch.
                values = np.zeros_like(values)
            if rows is None:
                rows = np.empty((len(self.who), *values.shape[1:]), dtype=values.dtype)
            rows[chosen] = values
        assert rows is not None
        return rows

    @cached_property
    def _pointed(self) -> set[PixelGrid]:
        """Signals that look at this step."""
        return set()

    # Images ----------------------------------------------------------------------------------

    @cached_property
    def levels(self) -> np.ndarray:
        """Tactile images before noise, float32 levels, [row, height_px, width_px, 3]."""
        if self.sensor.color is None:
            images = np.stack([self._predicted(env) for env in self.who.tolist()])
        elif self.surface_kind == "gel":
            images = self.tactile("rgb_levels")
        else:
            images = np.concatenate([self._painted(row) for row in range(len(self.who))])
        images = images.astype(np.float32)
        for row, env in enumerate(self.who.tolist()):
            for light in self._lights(env):
                images[row] = light.apply(images[row : row + 1])[0]
        return images

    def _lights(self, env: int) -> list[Perturbation]:
        touch = self.touches[env]
        lights = (self.sensor.units[touch.unit].light, touch.light)
        return [light for light in lights if light is not None]

    def _painted(self, row: int) -> np.ndarray:
        """The image of one row from its surface by the colour model, [1, ...]."""
        assert self.sensor.color is not None
        unit = self.touches[int(self.who[row])].unit
        height, slope = self.seen
        if unit not in self._painters:
            rest = self.sensor.rest(unit)
            slopes = -rest.normals[..., :2] / rest.normals[..., 2:]
            self._painters[unit] = DeviceColorModel(
                *self.sensor.color, _samples(slopes, 0 * rest.height_m)
            )
        rise = height[row] - self.rest_height_m[row]
        samples = _samples(slope[row], rise)
        levels = wp.empty((1, *rise.shape, 3), dtype=wp.float32, device="cpu")
        self._painters[unit].render(samples.reshape((1, *rise.shape)), levels=levels)
        return levels.numpy()

    def _predicted(self, env: int) -> np.ndarray:
        """The image that the optical model expects."""
        sensor = self.sensor
        assert sensor.optics is not None
        if env not in self._optical:
            size = (sensor.grid.width_px, sensor.grid.height_px)
            self._optical[env] = OpticalModel(
                sensor.optics, self.meshes[env], size_px=size, markers=sensor.painted
            )
        row = int(np.searchsorted(self.who, env))
        return self._optical[env].render(self.positions_m[row]).rgb

    # Markers ---------------------------------------------------------------------------------

    @cached_property
    def markers_px(self) -> np.ndarray:
        """Where the markers are (u, v), [row, marker, 2]."""
        found = []
        for row, env in enumerate(self.who.tolist()):
            if env not in self._layouts:
                self._layouts[env] = MarkerLayout.from_points(
                    self.meshes[env], self.sensor.marker_places_mm()
                )
            layout = self._layouts[env]
            points = (self.positions_m[row][layout.nodes] * layout.weights[..., None]).sum(axis=1)
            found.append(self.grid(env).pixel_from_gel(points[:, :2] * 1e3))
        return np.stack(found)


def _samples(slope: np.ndarray, rise_m: np.ndarray) -> wp.array:
    """Samples of a surface as ``DeviceColorModel`` takes them, on the host."""
    values = np.concatenate([slope, rise_m[..., None]], axis=-1)
    return wp.array(values.astype(np.float32), dtype=wp.vec3f, device="cpu")
