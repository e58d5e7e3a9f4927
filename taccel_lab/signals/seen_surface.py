# SPDX-License-Identifier: Apache-2.0
"""The contact face as the pixels of a view show it, in chunks of environments.

Along the gel's normal that is the sampled surface itself; a perspective camera looks at it
(``Looking``).
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import warp as wp

from taccel_lab.camera.gel_camera import GelCamera, View, face_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.looking import Looking
from taccel_lab.signals.raster import GridMap, grid_map, pixel_xy, place_xy
from taccel_lab.signals.surface_sampler import SurfaceSampler
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

FINE = ("contact", "pressure_pa")
"""Signals of contact that a fine surface knows itself."""


@wp.kernel
def _map_height_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    height_m: wp.array3d(dtype=wp.float32),
):
    env, v, u = wp.tid()
    height_m[env, v, u] = samples[env, v, u][2]


@wp.kernel
def _map_depth_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    rest_samples: wp.array3d(dtype=wp.vec3f),
    # Out
    depth_m: wp.array3d(dtype=wp.float32),
):
    env, v, u = wp.tid()
    depth_m[env, v, u] = rest_samples[env % rest_samples.shape[0], v, u][2] - samples[env, v, u][2]


@wp.kernel
def _map_points_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    places: wp.array3d(dtype=wp.vec2f),
    grid: GridMap,
    # Out
    points_m: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    height = samples[env, v, u][2]
    point = wp.vec3f(wp.nan, wp.nan, wp.nan)
    if not wp.isnan(height):
        xy = pixel_xy(grid, u, v)
        point = wp.vec3f(float(xy[0]), float(xy[1]), height)
        if places:
            # Of the face that a perspective camera looks at.
            place = places[env, v, u]
            xy = place_xy(grid, wp.float64(place[0]), wp.float64(place[1]))
            point = wp.vec3f(float(xy[0]), float(xy[1]), height)
    points_m[env, v, u] = point


@wp.kernel
def _map_normals_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    normals: wp.array3d(dtype=wp.vec3f),
):
    env, v, u = wp.tid()
    s = samples[env, v, u]
    inverse = wp.float32(1.0) / wp.sqrt(wp.float32(1.0) + s[0] * s[0] + s[1] * s[1])
    normals[env, v, u] = wp.vec3f(-s[0] * inverse, -s[1] * inverse, inverse)


wp.set_module_options({"enable_backward": False})


class SeenSurface:
    """Surfaces of one gel; arrays are valid until the next chunk."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        view: View,
        *,
        rows: int,
        first_node: int,
        device: Any,
        fine: FineSurface | None,
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest.
            view: Pixels of the image.
            rows: Most environments of a chunk.
            first_node: Of the gel in the arrays of positions.
            device: Warp device.
            fine: Shows an object's surface where it touches.
        """
        self.grid = face_of(view) if fine is None else fine.grid
        """Pixels over the gel that it is computed on."""
        self.fine = fine
        self._options: dict[str, Any] = {
            "env_count": rows, "first_node": first_node, "device": device
        }  # fmt: skip
        self._mesh, self._made = mesh, None
        self.looking: Looking | None = None
        """How a perspective camera sees it; None along the gel's normal."""
        if isinstance(view, GelCamera):
            self.looking = Looking(view, self.grid, rows=rows, device=device)
        self._part: slice | None = None
        self._fields: list[wp.array] = []
        self._rows = rows
        self._seen: tuple[wp.array, wp.array] | None = None

    @property
    def sampler(self) -> SurfaceSampler:
        """What samples the surface of the mesh; made when it is first needed."""
        if self._made is None:
            self._made = SurfaceSampler(self._mesh, self.grid, **self._options)
        return self._made

    @property
    def made(self) -> SurfaceSampler | None:
        """The sampler, if it was needed so far."""
        return self._made

    @property
    def rest_samples(self) -> wp.array:
        """Samples of the undeformed gel, vec3f, [row, column] of ``grid``."""
        return (self.fine or self.sampler).rest_samples

    @property
    def places(self) -> wp.array | None:
        """Where on ``grid`` the pixels of the latest chunk look, (column, row), vec2f [row, ...];
        None where pixel and place are the same."""
        if self.looking is None or self._seen is None:
            return None
        return self.looking.places(len(self._seen[0]))

    def forget(self) -> None:
        """The positions are others now."""
        self._part = None

    def chunk(
        self,
        positions: wp.array,
        state: State | None,
        frames: wp.array,
        envs: wp.array,
        part: slice,
    ) -> tuple[wp.array, wp.array]:
        """Samples (slope along x, along y, height [m]; NaN for none) of some environments, vec3f
        [row, ...], and of the points that they show as these are at rest, [row or 1, ...].

        Args:
            positions: Of nodes [m], vec3d, [env_count, node_count].
            state: That has them, which a fine surface needs.
            frames: world_from_gel, transformd, [env_count], or of length 0.
            envs: Numbers of the environments of the rows, int32.
            part: Which of the rows.

        Raises:
            InputError: No state for a fine surface.
        """
        if self._part == part and self._seen is not None:
            return self._seen
        count = part.stop - part.start
        if self.fine is not None:
            if state is None:
                raise InputError("a fine surface needs the state of the solver: update(state)")
            if part.start == 0:
                self.fine.update(state)
            samples, *self._fields = self.fine.sample(state, frames, envs)
        else:
            samples = self.sampler.sample(positions, frames, envs)
        rest = self.rest_samples.reshape((1, *self.rest_samples.shape))
        if self.looking is not None:
            samples, rest = self.looking.meet(samples), self.looking.rest(rest, count)
        self._seen, self._part = (samples, rest), part
        return self._seen

    def show_contact(self, outputs: dict[str, wp.array]) -> None:
        """Write those of ``FINE`` among ``outputs`` for the fine surface of the latest chunk."""
        for name in outputs.keys() & set(FINE):
            pressure, touched = self._fields
            self.show(pressure if name == "pressure_pa" else touched, outputs[name])

    def show_maps(self, outputs: dict[str, wp.array]) -> None:
        """Write those of height, depth, normals and points of the latest chunk in ``outputs``."""
        if self._seen is None:
            return
        samples, rest = self._seen
        for name, kernel, further in (
            ("height_m", _map_height_kernel, []),
            ("depth_m", _map_depth_kernel, [rest]),
            ("normals", _map_normals_kernel, []),
            ("points_m", _map_points_kernel, [self.places, grid_map(self.grid)]),
        ):
            if name in outputs:
                shown = outputs[name]
                inputs = [samples, *further]
                wp.launch(kernel, shown.shape, inputs, [shown], device=shown.device)

    def show(self, field: wp.array, shown: wp.array) -> None:
        """Bring a field on ``grid`` to the pixels, for the environments of the latest chunk."""
        if self.looking is None:
            wp.copy(shown, field)
        else:
            self.looking.show(field, shown)
