# SPDX-License-Identifier: Apache-2.0
"""What a step of some environments led to: read once, when a channel asks for it.

Rows are environments of ``who``, in order. What lies on the device, surfaces and images above all
(``FineSurface``), is read there for all of them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import GelCamera, face_of
from taccel_lab.camera.gel_camera import View as Pixels
from taccel_lab.datasets.motion import Touch
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.optics.render import OpticalModel
from taccel_lab.outputs import Outputs
from taccel_lab.outputs.surface_load import SurfaceLoad
from taccel_lab.presses.env import PressEnv
from taccel_lab.presses.physics import PressError
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from taccel_lab.signals.faulty_frames import FaultyFrames
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.perturbation import Perturbation
from taccel_lab.signals.perturbed_sensors import PerturbedSensors
from taccel_lab.signals.tactile import SIGNALS, SignalTactile
from taccel_lab.solvers import StepReport

PIXELS = {"rgb", "depth_mm", "normals", "contact_mask", *SIGNALS} - {"markers_px"}
"""Channels that have pixels."""
COARSE_PX = 160
"""Width of the image that a contact's area is measured on where no image shows the contact."""


class TouchView:
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
        ``spec.DatasetOutput``."""
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
        self._tactile: dict[Pixels, SignalTactile] = {}
        self._fine: dict[Pixels, FineSurface] = {}
        self._optical: dict[int, OpticalModel] = {}
        self._cameras: dict[int, FaultyFrames] = {}
        body = env.model.scene.soft_body(0)
        places, mesh, rests = sensor.marker_places_mm(), body.nodal_mesh, body.nodal_rest_m
        layout = MarkerLayout.from_points(mesh, places, rests)
        self._layout = layout.over(sensor.mesh, places, mesh, rests)
        self.who = np.zeros(0, dtype=np.int64)
        self.step = 0
        self.touching = False
        self.report: StepReport | None = None
        self.commands = np.zeros((0, 6))

    def at(
        self, step: int, who: np.ndarray, commands: np.ndarray, report: StepReport | None
    ) -> None:
        """Turn to step ``step`` of the environments ``who`` (int, [row]); step 0 is the gel at
        rest, with no report and no forces. ``commands``: where they were sent, [row, 6]."""
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
        """Forces of the gel's nodes on the object, in the gel frame, [row, node, 3]."""
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
        return self.env.error_estimate()

    def errors(self, name: str) -> np.ndarray:
        """One of ``PressError``, [row]; 0 for the untouched gel."""
        if not self.touching:
            return np.zeros(len(self.who))
        return getattr(self.error, name)[self.who]

    @cached_property
    def press_force_n(self) -> np.ndarray:
        """Force of the gel on the object in the press frame, [row, 3]."""
        if not self.touching:
            return np.zeros((len(self.who), 3))
        return self.env.press_force[self.who]

    def reported(self, name: str, rest: float) -> np.ndarray:
        """A figure of the step's report, [row]; ``rest`` where there was no step."""
        if self.report is None:
            return np.full(len(self.who), rest)
        return np.asarray(getattr(self.report, name))[self.who]

    # Surfaces --------------------------------------------------------------------------------

    def camera(self, env: int) -> Pixels:
        """What the pixels of an environment's images see."""
        return self.sensor.unit_camera(self.touches[env].unit)

    @cached_property
    def contact_area_m2(self) -> np.ndarray:
        """Area in contact, [row]."""
        area = np.zeros(len(self.who))
        if self.touching:
            self.tactile("contact")
            for view, chosen in self._rows_by_view().items():
                area[chosen] = self._fine[view].contact_area_m2[self.who[chosen]]
        return area

    def _rows_by_view(self) -> dict[Pixels, list[int]]:
        rows: dict[Pixels, list[int]] = {}
        for row, env in enumerate(self.who.tolist()):
            rows.setdefault(self._shown_view(env), []).append(row)
        return rows

    def _shown_view(self, env: int) -> Pixels:
        """Pixels that surfaces are read on: those of the images, or coarser ones over the gel for
        the area in contact alone."""
        camera = self.camera(env)
        if self._images:
            return camera
        grid = face_of(camera)
        if grid.width_px <= COARSE_PX:
            return grid
        return grid.resized(COARSE_PX, max(2, round(grid.height_px * COARSE_PX / grid.width_px)))

    def _signals_of(self, view: Pixels, env: int) -> SignalTactile:
        """The signals of one of the views, which that environment is seen in."""
        if view not in self._tactile:
            body = self.env.model.scene.kinematic_bodies[0].name
            rest = self.sensor.rest(self.touches[env].unit) if self._images else None
            fine = FineSurface(self.env.solver, body, view, designed_rest=rest)
            model, background = (self._images and self.sensor.color) or (None, None)
            self._fine[view] = fine
            self._tactile[view] = SignalTactile.from_solver(
                self.env.solver,
                view,
                fine=fine,
                color_model=model,
                background_rgb=background,
                markers=self._layout,
                dots=None if model is None else self.sensor.dots,
            )
        return self._tactile[view]

    def tactile(self, name: str) -> np.ndarray:
        """A signal of ``SignalTactile`` by its name, a row each."""
        rows: np.ndarray | None = None
        for view, chosen in self._rows_by_view().items():
            signal = self._signals_of(view, int(self.who[chosen[0]]))
            shown = np.zeros(len(self.touches), dtype=bool)
            shown[self.who[chosen]] = True
            if view not in self._pointed:
                self._pointed.add(view)
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
    def _pointed(self) -> set[Pixels]:
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
                images[row] = PerturbedSensors(light).apply(images[row : row + 1])[0]
        for row, frames in enumerate(self._faulty):
            images[row] = frames.lit(wp.array(images[row][None], device="cpu")).numpy()[0]
        return images

    def sent(self, levels: np.ndarray) -> np.ndarray:
        """Whole levels of images as they arrive, [row, height_px, width_px, 3]."""
        images = levels.astype(np.uint8)
        for row, frames in enumerate(self._faulty):
            images[row] = frames.sent(wp.array(images[row][None], device="cpu")).numpy()[0]
        return images

    @cached_property
    def _faulty(self) -> list[FaultyFrames]:
        """Cameras of the rows, turned to this step; none where no image can be faulty. The
        untouched gel stays whole: others' images are seen against it."""
        faults, grid = self.touches[0].faults, self.sensor.grid
        if faults is None:
            return []
        for env in self.who.tolist():
            if env not in self._cameras:
                size = (grid.width_px, grid.height_px)
                self._cameras[env] = FaultyFrames(faults, size, 1, first=1)
            key = (self.touches[env].fault_seed, 0, self.step)
            self._cameras[env].draw(*(wp.array([n], dtype=wp.int32, device="cpu") for n in key))
        return [self._cameras[env] for env in self.who.tolist()]

    @cached_property
    def fault_labels(self) -> np.ndarray:
        """What is wrong with the images, see ``FaultyFrames.labels``, [row]."""
        return np.concatenate([frames.labels() for frames in self._faulty])

    def _lights(self, env: int) -> list[Perturbation]:
        touch = self.touches[env]
        lights = (self.sensor.units[touch.unit].light, touch.light)
        return [light for light in lights if light is not None]

    def _predicted(self, env: int) -> np.ndarray:
        """The image that the optical model expects."""
        sensor = self.sensor
        camera = self.camera(env)
        assert sensor.optics is not None and isinstance(camera, GelCamera)
        if env not in self._optical:
            options = {"markers": sensor.painted, "designed": sensor.mesh}
            mesh = self.meshes[env]
            self._optical[env] = OpticalModel.through(camera, sensor.optics, mesh, **options)
        row = int(np.searchsorted(self.who, env))
        return self._optical[env].render(self.positions_m[row]).rgb

    # Markers ---------------------------------------------------------------------------------

    @cached_property
    def markers_px(self) -> np.ndarray:
        """Where the markers are (u, v), [row, marker, 2]."""
        return np.stack([
            self.camera(env).pixel_from_gel(self._layout.places_mm(self.positions_m[row], env))
            for row, env in enumerate(self.who.tolist())
        ])  # fmt: skip
