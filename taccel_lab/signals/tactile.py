# SPDX-License-Identifier: Apache-2.0
"""``SignalTactile``: what many sensors see, from device arrays to device arrays.

The surface of ``SurfaceSampler`` and the colours of ``DeviceColorModel``, for a thousand
environments without a host round trip: nothing here waits for the device or looks at its values,
so that reads can be captured in a CUDA graph. Only what is read is computed, in chunks of
environments of fixed size.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.model.env_rows import chosen_envs
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.markers import MarkerLayout, MarkerProjection
from taccel_lab.signals.surface_sampler import SurfaceMode, SurfaceSampler
from taccel_lab.signals.tactile_image import DeviceColorModel

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

wp.set_module_options({"enable_backward": False})

CHUNK_PIXELS = 2**24
"""Pixels computed at a time: 24 bytes of scratch each."""

_IMAGES = ("rgb", "rgb_levels", "height_m", "normals")
SIGNALS = (*_IMAGES, "markers_px")
"""Names that ``SignalTactile.read`` knows."""


@wp.kernel
def _height_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    height_m: wp.array3d(dtype=wp.float32),
):
    env, v, u = wp.tid()
    height_m[env, v, u] = samples[env, v, u][2]


@wp.kernel
def _normals_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    normals: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    s = samples[env, v, u]
    inverse = wp.float32(1.0) / wp.sqrt(wp.float32(1.0) + s[0] * s[0] + s[1] * s[1])
    normals[env, v, u] = wp.vec3f(-s[0] * inverse, -s[1] * inverse, inverse)


class SignalTactile:
    """Tactile images, height maps, normals and markers of one sensor in many environments.

    Construct, call ``update(positions)`` after each step, read the signals you want. A signal that
    is not read is not computed and takes no memory. Arrays are Warp arrays on the device of the
    positions, the same ones at each read, or their first rows where only some environments are
    shown; ``wp.to_torch(signal.rgb)`` shares their memory.
    """

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        env_count: int,
        color_model: ColorModel | None = None,
        background_rgb: np.ndarray | None = None,
        markers: MarkerLayout | None = None,
        mode: SurfaceMode = SurfaceMode.SMOOTH,
        first_node: int = 0,
        device: Any = "cpu",
        still_levels: float = 0.0,
        chunk_pixels: int = CHUNK_PIXELS,
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest, the same in all environments; its faces of region CONTACT are
                shown.
            grid: Pixels of the image.
            env_count: Number of environments.
            color_model: For ``rgb`` and ``rgb_levels``.
            background_rgb: Image of the untouched sensor, levels, [height_px, width_px, 3].
            markers: For ``markers_px``.
            mode: How the surface between the nodes is rebuilt.
            first_node: Of this gel in the arrays of positions.
            device: Warp device.
            still_levels: Pixels whose colour would change by less [levels of 255], to first order,
                show the background; zero to compute all that moved. A press moves the whole gel a
                little, so this saves most of the image where 0.1 levels do not matter.
            chunk_pixels: Most pixels computed at a time; at least one image.
        """
        if env_count < 1:
            raise InputError(f"env_count must be at least 1, got {env_count}")
        if (color_model is None) != (background_rgb is None):
            raise InputError("color_model and background_rgb must be given together")
        self.grid = grid
        self.env_count = env_count
        self.device = wp.get_device(device)
        self._color = None if color_model is None else (color_model, background_rgb)
        self._still_levels = still_levels
        self._mesh = mesh
        self._markers = markers
        self._mode = mode
        self._first_node = first_node
        # A face's record takes as much scratch as eight pixels.
        face_count = int((mesh.face_regions == int(Region.CONTACT)).sum())
        pixels = grid.width_px * grid.height_px + 8 * face_count
        self.chunk_envs = min(env_count, max(1, chunk_pixels // pixels))
        """Environments computed at a time."""
        self._sampler: SurfaceSampler | None = None
        self._painter: DeviceColorModel | None = None
        self._projection: MarkerProjection | None = None
        self._arrays: dict[str, Any] = {}
        self._fresh: set[str] = set()
        self._samples: Any = None
        self._positions: Any = None
        self._no_frames = wp.empty(0, dtype=wp.transformd, device=self.device)
        self._frames: Any = self._no_frames
        self._all_envs = wp.empty(0, dtype=wp.int32, device=self.device)
        self._envs: Any = self._all_envs
        self._count = env_count
        """Environments that are shown."""

    @classmethod
    def from_profile(
        cls, profile: SensorProfile, *, env_count: int, **options: Any
    ) -> SignalTactile:
        """The signals of a profile's sensor.

        Args:
            profile: Its mesh, camera and, where it has them, background and colour model.
            env_count: Number of environments.
            options: Further arguments of ``SignalTactile``, such as ``markers`` and ``device``.
        """
        color: dict[str, Any] = {}
        model = ColorModel.from_profile(profile)
        if model is not None and profile.background_rgb is not None:
            color["color_model"] = model
            color["background_rgb"] = profile.background_rgb
        return cls(profile.mesh, profile.grid(), env_count=env_count, **color, **options)

    def update(
        self,
        positions: wp.array,
        world_from_gel: wp.array | None = None,
        who: np.ndarray | None = None,
    ) -> None:
        """Point the signals at a state; launches nothing.

        Args:
            positions: Node positions [m], vec3d, shape [env_count, node_count], on the device of
                the signal. They are read when a signal is, so read before they change, and call
                ``update`` again after they did.
            world_from_gel: Pose of the gel in each environment, transformd, shape [env_count], for
                instance ``state.poses[:, mount]``; None when positions are in the gel frame.
            who: Environments to show, bool, [env_count], of the host; all when None. Signals then
                have a row for each of these, in their order. Their list goes to the device at once,
                which a CUDA graph does not repeat.
        """
        least = self._first_node + self._mesh.node_count
        if positions.dtype != wp.vec3d or positions.ndim != 2:
            raise InputError("positions must be a Warp array of vec3d, shape [env_count, node]")
        if positions.shape[0] != self.env_count or positions.shape[1] < least:
            raise InputError(
                f"positions has shape {positions.shape}; {self.env_count} environments of at "
                f"least {least} nodes are needed"
            )
        if positions.device != self.device:
            raise InputError(f"positions are on {positions.device}, the signal on {self.device}")
        if world_from_gel is not None and (
            world_from_gel.dtype != wp.transformd or world_from_gel.shape != (self.env_count,)
        ):
            raise InputError(
                f"world_from_gel must be a Warp array of transformd, shape [{self.env_count}]"
            )
        self._positions = positions
        self._frames = self._no_frames if world_from_gel is None else world_from_gel
        self._envs, self._count = self._all_envs, self.env_count
        if who is not None:
            self._envs = chosen_envs(who, self.env_count, self.device)
            self._count = len(self._envs)
        self._fresh.clear()
        self._samples = None

    @property
    def rgb(self) -> wp.array:
        """Tactile image, RGB rounded to uint8, shape [env, height_px, width_px, 3]."""
        return self.read("rgb")[0]

    @property
    def rgb_levels(self) -> wp.array:
        """Tactile image unrounded, float32 levels 0..255, [env, height_px, width_px, 3]."""
        return self.read("rgb_levels")[0]

    @property
    def height_m(self) -> wp.array:
        """Height of the contact surface [m], float32, [env, height_px, width_px], NaN outside."""
        return self.read("height_m")[0]

    @property
    def normals(self) -> wp.array:
        """Outward unit normals in the gel frame, vec3f, [env, height_px, width_px], NaN outside."""
        return self.read("normals")[0]

    @property
    def markers_px(self) -> wp.array:
        """Columns and rows (u, v) of the markers [px], vec2f, shape [env, marker]."""
        return self.read("markers_px")[0]

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
            self._projection.update(self._positions, self._frames, self._envs, self._count)
        images = [name for name in stale if name in _IMAGES]
        if images:
            self._render(images)
        self._fresh.update(stale)
        arrays = [self._arrays[name] for name in names]
        if self._count < self.env_count:
            arrays = [array[: self._count] for array in arrays]
        return tuple(arrays)

    def rasterized_count(self) -> int:
        """How many environments of the latest chunk were folded or left pixels beside the pad,
        which takes longer; waits for the device. For tests and figures."""
        return 0 if self._sampler is None else int(np.count_nonzero(self._sampler.rasterized))

    def _make(self, name: str) -> Any:
        """Allocate a signal and what computes it, at its first read."""
        if name not in SIGNALS:
            raise InputError(f"unknown signal {name!r}; known are {', '.join(SIGNALS)}")
        if name == "markers_px":
            if self._markers is None:
                raise InputError("markers_px needs the markers argument of SignalTactile")
            self._projection = MarkerProjection(
                self._markers,
                self.grid,
                env_count=self.env_count,
                first_node=self._first_node,
                device=self.device,
            )
            return self._projection.markers_px
        if self._sampler is None:
            self._sampler = SurfaceSampler(
                self._mesh,
                self.grid,
                env_count=self.chunk_envs,
                first_node=self._first_node,
                mode=self._mode,
                device=self.device,
            )
        shape = (self.env_count, self.grid.height_px, self.grid.width_px)
        if name in ("rgb", "rgb_levels"):
            if self._color is None:
                raise InputError(f"{name} needs the color_model argument of SignalTactile")
            if self._painter is None:
                self._painter = DeviceColorModel(
                    *self._color, self._sampler.rest_samples, self._still_levels
                )
            dtype = wp.uint8 if name == "rgb" else wp.float32
            return wp.empty((*shape, 3), dtype=dtype, device=self.device)
        dtype = wp.float32 if name == "height_m" else wp.vec3f
        return wp.empty(shape, dtype=dtype, device=self.device)

    def _render(self, names: list[str]) -> None:
        """Bring images up to date, chunk by chunk."""
        assert self._sampler is not None
        for first in range(0, self._count, self.chunk_envs):
            part = slice(first, min(first + self.chunk_envs, self._count))
            samples = self._samples
            if samples is None and len(self._envs):
                samples = self._sampler.sample(self._positions, self._frames, self._envs[part])
            elif samples is None:
                frames = self._frames[part] if len(self._frames) else self._frames
                samples = self._sampler.sample(self._positions[part], frames)
            if self.chunk_envs == self.env_count:
                # The only chunk: other images of this state may still read its samples.
                self._samples = samples
            outputs = {name: self._arrays[name][part] for name in names}
            if "height_m" in outputs:
                self._map(_height_kernel, samples, outputs["height_m"])
            if "normals" in outputs:
                self._map(_normals_kernel, samples, outputs["normals"])
            if self._painter is not None and ("rgb" in outputs or "rgb_levels" in outputs):
                self._painter.render(samples, outputs.get("rgb"), outputs.get("rgb_levels"))

    def _map(self, kernel: Any, samples: wp.array, output: wp.array) -> None:
        wp.launch(kernel, dim=samples.shape, inputs=[samples], outputs=[output], device=self.device)
