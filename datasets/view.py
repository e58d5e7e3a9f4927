# SPDX-License-Identifier: Apache-2.0
"""What a step of some environments led to: read once, when a channel asks for it.

Rows are environments of ``who``, in order. What lies on the device, surfaces and images above all
(``FineSurface``), is read there for all of them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from taccel_lab.datasets.sensor import Sensor
from taccel_lab.datasets.touch import Touch
from taccel_lab.envs.press import PressEnv, PressError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.optics.render import OpticalModel
from taccel_lab.outputs import Outputs
from taccel_lab.outputs.surface_load import SurfaceLoad
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.perturbation import Perturbation
from taccel_lab.signals.tactile import SIGNALS, SignalTactile
from taccel_lab.solvers import StepReport

PIXELS = {"rgb", "depth_mm", "normals", "contact_mask", *SIGNALS} - {"markers_px"}
"""Channels that have pixels."""
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
        patches: tuple[int, int],
        channels: Sequence[str],
    ) -> None:
        """``meshes``: of the environments, with all their nodes; ``patches`` and ``channels`` as in
        ``spec.Output``."""
        self.env, self.touches, self.meshes, self.sensor = env, touches, meshes, sensor
        self.patches, self.channels = patches, channels
        self._images = not PIXELS.isdisjoint(channels)
        known = {"rgb": "rgb_levels", "depth_mm": "depth_m", "contact_mask": "contact"}
        if sensor.color is None:
            del known["rgb"]
        wanted = {known.get(name, name) for name in channels} & {*SIGNALS} - {"rgb", "markers_px"}
        self._signals = sorted(wanted | {"contact"})
        self._outputs = Outputs(env.solver)
        self.face_nodes = np.unique(env.mesh.region_faces(Region.CONTACT))
        """Nodes of the contact face, [face_node]."""
        self._tactile: dict[PixelGrid, SignalTactile] = {}
        self._fine: dict[PixelGrid, FineSurface] = {}
        self._optical: dict[int, OpticalModel] = {}
        body = env.model.scene.soft_body(0)
        self._layout = MarkerLayout.from_points(
            body.nodal_mesh, sensor.marker_places_mm(), body.nodal_rest_m
        )
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
    def contact_area_m2(self) -> np.ndarray:
        """Area in contact, [row]."""
        area = np.zeros(len(self.who))
        if self.touching:
            self.tactile("contact")
            for grid, chosen in self._rows_by_grid().items():
                area[chosen] = self._fine[grid].contact_area_m2[self.who[chosen]]
        return area

    def _rows_by_grid(self) -> dict[PixelGrid, list[int]]:
        rows: dict[PixelGrid, list[int]] = {}
        for row, env in enumerate(self.who.tolist()):
            rows.setdefault(self._shown_grid(env), []).append(row)
        return rows

    def _shown_grid(self, env: int) -> PixelGrid:
        """Pixels that surfaces are read on: those of the images, or coarser for the area in contact
        alone."""
        grid = self.grid(env)
        if self._images or grid.width_px <= COARSE_PX:
            return grid
        return grid.resized(COARSE_PX, max(2, round(grid.height_px * COARSE_PX / grid.width_px)))

    def _signals_of(self, grid: PixelGrid, env: int) -> SignalTactile:
        """The signals on one of the grids, which that environment is seen on."""
        if grid not in self._tactile:
            body = self.env.model.scene.kinematic_bodies[0].name
            rest = self.sensor.rest(self.touches[env].unit) if self._images else None
            fine = FineSurface(self.env.solver, body, grid, designed_rest=rest)
            model, background = (self._images and self.sensor.color) or (None, None)
            self._fine[grid] = fine
            self._tactile[grid] = SignalTactile.from_solver(
                self.env.solver,
                grid,
                fine=fine,
                color_model=model,
                background_rgb=background,
                markers=self._layout,
                dots=None if model is None else self.sensor.dots,
            )
        return self._tactile[grid]

    def tactile(self, name: str) -> np.ndarray:
        """A signal of ``SignalTactile`` by its name, a row each."""
        rows: np.ndarray | None = None
        for grid, chosen in self._rows_by_grid().items():
            signal = self._signals_of(grid, int(self.who[chosen[0]]))
            shown = np.zeros(len(self.touches), dtype=bool)
            shown[self.who[chosen]] = True
            if grid not in self._pointed:
                self._pointed.add(grid)
                signal.update(self.env.state, who=shown)
                # All that is going to be asked for, as the surface is sampled once for it.
                signal.read(*self._signals)
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
        else:
            images = self.tactile("rgb_levels")
        images = images.astype(np.float32)
        for row, env in enumerate(self.who.tolist()):
            for light in self._lights(env):
                images[row] = light.apply(images[row : row + 1])[0]
        return images

    def _lights(self, env: int) -> list[Perturbation]:
        touch = self.touches[env]
        lights = (self.sensor.units[touch.unit].light, touch.light)
        return [light for light in lights if light is not None]

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
        nodes, weights = self._layout.by_rest()
        found = []
        for row, env in enumerate(self.who.tolist()):
            gel = env % len(nodes)
            corners = self.positions_m[row][nodes[gel]]
            points = (corners * weights[gel][..., None]).sum(axis=1)
            found.append(self.grid(env).pixel_from_gel(points[:, :2] * 1e3))
        return np.stack(found)
