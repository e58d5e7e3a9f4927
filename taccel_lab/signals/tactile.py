# SPDX-License-Identifier: Apache-2.0
"""``SignalTactile``: what many sensors see and feel, from device arrays to device arrays.

The surface of ``SurfaceSampler`` and the colours of ``DeviceColorModel``, for a thousand
environments without a host round trip: nothing waits for the device or looks at its values, so that
reads can be captured in a CUDA graph, as images are. Only what is read is computed, in chunks of
environments.
"""

# Warp's type stubs describe neither arrays of vectors nor what kernels take.
# pyright: reportArgumentType=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import View, face_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.guards import require_known
from taccel_lab.model.launches import require_device
from taccel_lab.model.turns import in_turn
from taccel_lab.outputs.gel_frames import GelFrames
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS, ContactFields
from taccel_lab.signals.dots import DotPainter, PaintedDots, profile_options, profile_view
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.markers import MarkerLayout, MarkerProjection
from taccel_lab.signals.seen_surface import FINE, SeenSurface
from taccel_lab.signals.shown_rows import CapturedReads, ShownRows
from taccel_lab.signals.tactile_image import DeviceColorModel
from taccel_lab.state import State, check_state

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.solvers.solver_ipc import SolverIPC

CHUNK_PIXELS = 2**24
"""Pixels computed at a time: 24 bytes of scratch each."""

_IMAGES = ("rgb", "rgb_levels", "height_m", "depth_m", "normals", "points_m")
SIGNALS = (*_IMAGES, "markers_px", *CONTACT_SIGNALS)
"""Names that ``SignalTactile.read`` knows; docs/signals.md has their shapes and units."""


class _Signal:
    """A signal as an attribute, read on demand."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, signal: SignalTactile, owner: type) -> wp.array:
        return signal.read(self._name)[0]


class SignalTactile:
    """What one sensor sees and feels in many environments: images, heights, markers, contact.

    Construct, call ``update(...)`` after each step, read the signals you want. A signal that is not
    read is not computed and takes no memory. Arrays are Warp arrays on the device of the positions,
    the same ones at each read, or their first rows where only some environments are shown;
    ``wp.to_torch(signal.rgb)`` shares their memory.
    """

    @in_turn
    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: View,
        *,
        env_count: int,
        color_model: ColorModel | None = None,
        background_rgb: np.ndarray | None = None,
        markers: MarkerLayout | None = None,
        dots: PaintedDots | None = None,
        first_node: int = 0,
        device: Any = "cpu",
        still_levels: float = 0.0,
        chunk_pixels: int = CHUNK_PIXELS,
        solver: SolverIPC | None = None,
        gel: int = 0,
        fine: FineSurface | None = None,
        capture: bool | None = None,
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest, the same in all environments; its faces of region CONTACT are
                shown.
            grid: Pixels of the image, over the gel or of its camera (``camera_of(profile)``).
            env_count: Number of environments.
            color_model: For ``rgb`` and ``rgb_levels``; colours are of a pixel grid.
            background_rgb: Image of the untouched sensor, levels, [height_px, width_px, 3].
            markers: For ``markers_px``; in each gel's rest shape where these differ.
            dots: Of the markers, to be seen in ``rgb`` and ``rgb_levels``; the background is then
                their ``clean_rgb``.
            first_node: Of this gel in the arrays of positions.
            device: Warp device.
            still_levels: Pixels whose colour would change by less [levels of 255], to first order,
                show the background; zero to compute all that moved. A press moves the whole gel a
                little, so this saves most of the image where 0.1 levels do not matter.
            chunk_pixels: Most pixels computed at a time; at least one image.
            solver: Whose forces ``contact``, ``pressure_pa``, ``traction_pa``, ``slip_m`` and
                ``slipping`` are of; see ``from_solver``.
            gel: Index of this gel among the soft bodies of the solver's scene.
            fine: Shows an object's surface where it touches, finer than the mesh, in images and
                heights, contact and pressure; of the same solver, gel and grid.
            capture: Whether images, but those of ``fine``, are read as graphs; on GPUs when None.
        """
        if env_count < 1:
            raise InputError(f"env_count must be at least 1, got {env_count}")
        if (color_model is None) != (background_rgb is None):
            raise InputError("color_model and background_rgb must be given together")
        if color_model is not None and not isinstance(grid, PixelGrid):
            raise InputError("colours are fitted on a pixel grid: give that in place of a camera")
        if dots is not None and (markers is None or color_model is None):
            raise InputError("dots need markers and color_model")
        self.grid = grid
        self.env_count = env_count
        self.device = require_device(device)
        self._color = None if color_model is None else (color_model, background_rgb)
        self._still_levels = still_levels
        self._mesh = mesh
        self._markers = markers
        self._first_node = first_node
        # A face's record takes as much scratch as eight pixels.
        face_count = int((mesh.face_regions == int(Region.CONTACT)).sum())
        face = face_of(grid)
        pixels = face.width_px * face.height_px + 8 * face_count
        self.chunk_envs = min(env_count, max(1, chunk_pixels // pixels))
        if fine is not None:
            self.chunk_envs = fine.env_count
        """Environments computed at a time."""
        self._dots: DotPainter | None = None
        if dots is not None and markers is not None and isinstance(grid, PixelGrid):
            rest = None if solver is None else solver.model.scene.soft_body(gel).nodal_rest_m
            options = {"rest_positions_m": rest, "first_node": first_node, "device": self.device}
            self._dots = DotPainter(dots, markers, mesh, grid, **options)
        options = {"first_node": first_node, "device": self.device, "fine": fine}
        self._surface = SeenSurface(mesh, grid, rows=self.chunk_envs, **options)
        self._painter: DeviceColorModel | None = None
        self._projection: MarkerProjection | None = None
        self._solver, self._gel = solver, gel
        self._fields: ContactFields | None = None
        self._gel_frames = None if solver is None else GelFrames(solver.model)
        self._state: State | None = None
        self._arrays: dict[str, Any] = {}
        self._over: dict[str, Any] = {}
        self._fresh: set[str] = set()
        self._positions: Any = None
        self._no_frames = wp.empty(0, dtype=wp.transformd, device=self.device)
        self._frames: Any = self._no_frames
        self._carried = wp.empty(env_count, dtype=wp.transformd, device=self.device)
        self._shown = ShownRows(env_count, self.device, self.chunk_envs)
        wanted = self.device.is_cuda if capture is None else capture
        self._reads = CapturedReads(self.device, wanted and fine is None)

    def __repr__(self) -> str:
        return f"signals on {self.device}, env_count = {self.env_count}, of a {self._mesh!r}"

    @classmethod
    def from_solver(
        cls, solver: SolverIPC, grid: View, *, gel: int = 0, **options: Any
    ) -> SignalTactile:
        """Read the signals of a gel of a solver's scene, those of its contact too.

        ``update(state)`` is all that it takes after a step: a gel that moves with a mount is looked
        at in its own frame.

        Args:
            solver: It keeps the forces of its last step.
            grid: Pixels of the image.
            gel: Index of the gel among the soft bodies of the scene.
            options: Further arguments of ``SignalTactile``, such as ``color_model``.

        Raises:
            InputError: No such soft body.
        """
        model = solver.model
        return cls(
            model.scene.soft_body(gel).nodal_mesh,
            grid,
            env_count=model.env_count,
            first_node=model.bodies[gel].node_slice.start,
            device=model.device,
            solver=solver,
            gel=gel,
            **options,
        )

    @classmethod
    def from_profile(
        cls,
        profile: SensorProfile,
        *,
        env_count: int | None = None,
        solver: SolverIPC | None = None,
        **options: Any,
    ) -> SignalTactile:
        """Read the signals of a profile's sensor, through its camera (``camera_of``): its dots that
        are seen and, where it has them, background and colour model: images show the dots.

        Args:
            profile: Sensor.
            env_count: Number of environments; that of the solver.
            solver: Of ``profile_scene``; signals of contact need it. ``update`` then takes the
                state. Without it positions are those of the profile's mesh.
            options: Further arguments of ``SignalTactile``, such as ``gel`` and ``device``; with
                ``markers`` or ``color_model`` of one's own, ``dots`` are those that are given.

        Raises:
            InputError: Neither ``env_count`` nor ``solver``, or no such gel.
        """
        if solver is not None:
            body = solver.model.scene.soft_body(options.get("gel", 0))
            given = profile_options(profile, body.nodal_mesh, options, body.nodal_rest_m)
            return cls.from_solver(solver, profile_view(profile, given), **given)
        if env_count is None:
            raise InputError("how many environments? Give env_count, or the solver that has them")
        given = profile_options(profile, profile.mesh, options)
        return cls(profile.mesh, profile_view(profile, given), env_count=env_count, **given)

    @in_turn
    def update(
        self,
        positions: wp.array | State,
        world_from_gel: wp.array | None = None,
        who: np.ndarray | None = None,
    ) -> None:
        """Point the signals at a state; launches nothing but what finds the frame of a gel on an
        affine body.

        Args:
            positions: Node positions [m], vec3d, shape [env_count, node_count], on the device of
                the signal, or the state that has them, which signals of contact need. They are read
                when a signal is, so read before they change, and call ``update`` again after.
            world_from_gel: Pose of the gel in each environment, transformd, shape [env_count], for
                instance ``state.poses[:, mount]``; None when positions are in the gel frame, and
                when the solver of ``from_solver`` is to say.
            who: Environments to show, bool, [env_count], of the host; all when None. Signals then
                have a row for each of these, in their order. Their list goes to the device at once,
                which a CUDA graph does not repeat.
        """
        self._state = None
        if isinstance(positions, State):
            self._state = positions
            if self._solver is not None:
                check_state(positions, self._solver.model)
            if world_from_gel is None and self._gel_frames is not None:
                world_from_gel = self._gel_frames.of(self._gel, positions)
                if world_from_gel is not None and self._gel_frames.carriers[self._gel] >= 0:
                    # It is another array each time, and graphs know one.
                    wp.copy(self._carried, world_from_gel)
                    world_from_gel = self._carried
            where: Any = positions.positions
        else:
            where = positions
        least = self._first_node + self._mesh.node_count
        if where.dtype != wp.vec3d or where.ndim != 2:
            raise InputError("positions must be a Warp array of vec3d, shape [env_count, node]")
        if where.shape[0] != self.env_count or where.shape[1] < least:
            raise InputError(
                f"positions has shape {where.shape}; {self.env_count} environments of at "
                f"least {least} nodes are needed"
            )
        if where.device != self.device:
            raise InputError(f"positions are on {where.device}, the signal on {self.device}")
        if world_from_gel is not None and (
            world_from_gel.dtype != wp.transformd or world_from_gel.shape != (self.env_count,)
        ):
            raise InputError(
                f"world_from_gel must be a Warp array of transformd, shape [{self.env_count}]"
            )
        self._positions = where
        self._frames = self._no_frames if world_from_gel is None else world_from_gel
        self._shown.show(who)
        self._fresh.clear()
        self._surface.forget()

    rgb = _Signal()
    """Tactile image, RGB rounded to uint8, shape [env, height_px, width_px, 3]."""
    rgb_levels = _Signal()
    """Tactile image unrounded, float32 levels 0..255, [env, height_px, width_px, 3]."""
    height_m = _Signal()
    """Height of the contact surface [m], float32, [env, height_px, width_px], NaN outside."""
    normals = _Signal()
    """Outward unit normals in the gel frame, vec3f, [env, height_px, width_px], NaN outside."""
    depth_m = _Signal()
    """How far the face has sunk since rest [m], float32, as ``height_m``."""
    points_m = _Signal()
    """Points of the face in the gel frame [m], vec3f, as ``height_m``."""
    contact = _Signal()
    """Where the gel is touched, bool, [env, height_px, width_px]."""
    pressure_pa = _Signal()
    """Contact pressure [Pa], float32, as ``height_m``, zero beside the contact."""
    traction_pa = _Signal()
    """Force on the gel by area of its face, in its axes [Pa], vec3f, as ``pressure_pa``."""
    slip_m = _Signal()
    """Sliding in the last step [m], vec3f, as ``traction_pa``; see ``outputs.Sliding``."""
    slipping = _Signal()
    """Where friction is at its limit, bool, as ``contact``, of which the rest sticks."""
    markers_px = _Signal()
    """Columns and rows (u, v) of the markers [px], vec2f, shape [env, marker]."""

    @in_turn
    def read(self, *names: str) -> tuple[wp.array, ...]:
        """Compute some of ``SIGNALS`` together, which shares their common work.

        Raises:
            InputError: Unknown name, or a signal without its color model or markers.
        """
        if self._positions is None:
            raise RuntimeError("update() must be called before a signal is read")
        stale = [name for name in dict.fromkeys(names) if name not in self._fresh]
        for name in stale:
            if name not in self._arrays:
                self._arrays[name] = self._make(name)
        if "markers_px" in stale and self._projection is not None:
            shown = self._shown
            self._projection.update(self._positions, self._frames, shown.numbers, shown.count)
        of_surface = _IMAGES if self._surface.fine is None else (*_IMAGES, *FINE)
        images = [name for name in stale if name in of_surface]
        if images:
            self._render(images)
        fields = [name for name in stale if name in CONTACT_SIGNALS and name not in images]
        if fields:
            self._render_contact(fields)
        self._fresh.update(stale)
        arrays = [self._arrays[name] for name in names]
        if self._shown.count < self.env_count:
            arrays = [array[: self._shown.count] for array in arrays]
        return tuple(arrays)

    def rest_samples(self) -> wp.array:
        """Slope along x, along y and height [m] at rest of the points that pixels of the first
        chunk show now, vec3f, [row or 1, height_px, width_px]; the same array at each call."""
        return self._look(next(self._shown.chunks(self._shown.count)))[1]

    def rasterized_count(self) -> int:
        """Count environments of the latest chunk that were folded or left pixels beside the pad,
        which takes longer; waits for the device. For tests and figures."""
        sampler = self._surface.made
        return 0 if sampler is None else int(np.count_nonzero(sampler.rasterized))

    def _make(self, name: str) -> Any:
        """Allocate a signal and what computes it, at its first read."""
        require_known("signal", name, SIGNALS)
        if name == "markers_px":
            if self._markers is None:
                raise InputError("markers_px needs the markers argument of SignalTactile")
            options = {"first_node": self._first_node, "device": self.device}
            self._projection = MarkerProjection(
                self._markers, self.grid, env_count=self.env_count, **options
            )
            return self._projection.markers_px
        shape = (self.env_count, self.grid.height_px, self.grid.width_px)
        if name in CONTACT_SIGNALS:
            return self._contact_fields(name).make(name, shape)
        if name in ("rgb", "rgb_levels"):
            if self._color is None:
                raise InputError(f"{name} needs the color_model argument of SignalTactile")
            if self._painter is None:
                self._painter = DeviceColorModel(
                    *self._color, self._surface.rest_samples, self._still_levels
                )
            dtype = wp.uint8 if name == "rgb" else wp.float32
            return wp.empty((*shape, 3), dtype=dtype, device=self.device)
        dtype = wp.float32 if name in ("height_m", "depth_m") else wp.vec3f
        return wp.empty(shape, dtype=dtype, device=self.device)

    def _contact_fields(self, name: str) -> ContactFields:
        """What computes contact signals; InputError without a solver."""
        if self._fields is None:
            if self._solver is None:
                raise InputError(
                    f"{name} needs the forces of a solver: make the signals with "
                    "SignalTactile.from_solver"
                )
            self._fields = ContactFields(
                self._solver, self._gel, self._mesh, self._surface.grid, chunk_envs=self.chunk_envs
            )
        return self._fields

    def _render_contact(self, names: list[str]) -> None:
        """Bring signals of contact up to date, chunk by chunk."""
        fields = self._contact_fields(names[0])
        if self._state is None:
            raise InputError(f"{names[0]} needs the state of the solver: update(state)")
        if self._shown.count:
            fields.read_nodes(self._state, set(names))
        for part in self._shown.chunks(self._shown.count):
            envs = self._shown.numbers[part]
            outputs = {name: self._arrays[name][part] for name in names}
            if self._surface.looking is None:
                fields.render(self._state, self._frames, envs, outputs)
                continue
            self._look(part)
            over = {name: self._over_gel(name)[: len(envs)] for name in names}
            fields.render(self._state, self._frames, envs, over)
            for name in names:
                self._surface.show(over[name], outputs[name])

    def _over_gel(self, name: str) -> wp.array:
        """Memory of a signal of contact over the gel, for a chunk."""
        if name not in self._over:
            grid = self._surface.grid
            shape = (self.chunk_envs, grid.height_px, grid.width_px)
            self._over[name] = self._contact_fields(name).make(name, shape)
        return self._over[name]

    def _look(self, part: slice) -> tuple[wp.array, wp.array]:
        """What pixels show of a chunk, now and at rest."""
        envs = self._shown.numbers[part]
        return self._surface.chunk(self._positions, self._state, self._frames, envs, part)

    def _render(self, names: list[str]) -> None:
        """Bring images up to date, as a graph if they are captured."""
        count, rows = self._shown.count, self._shown.rounded
        if not (count and self._reads.captures):
            self._render_rows(names, count)
            return

        def work() -> None:
            # What an earlier read has sampled is not part of the graph, nor is this for later ones.
            self._surface.forget()
            self._render_rows(names, rows)

        arrays = [self._positions, self._frames, self._shown.numbers]
        self._reads.launch((frozenset(names), rows), arrays, work)
        self._surface.forget()

    def _render_rows(self, names: list[str], rows: int) -> None:
        """Bring the first rows of images up to date, chunk by chunk."""
        for part in self._shown.chunks(rows):
            outputs = {name: self._arrays[name][part] for name in names}
            samples, _ = self._look(part)
            self._surface.show_contact(outputs)
            self._surface.show_maps(outputs)
            if self._painter is not None and ("rgb" in outputs or "rgb_levels" in outputs):
                found = outputs.get("rgb"), outputs.get("rgb_levels")
                self._painter.render(samples, *found)
                if self._dots is not None:
                    envs = self._shown.numbers[part]
                    self._dots.paint(self._positions, self._frames, envs, *found)
