# SPDX-License-Identifier: Apache-2.0
"""``SensorTactile``: what a gel of a ``SolverGel`` shows and feels, after the pattern of newton's
sensors: construct, ``update`` after a step, read arrays.

Forces on the nodes of a soft surface are what newton's own contact sensor, which is of rigid
contacts, has not (newton's issues 2967 and 3052).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import camera_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.guards import require_known
from taccel_lab.newton_bridge.solver_gel import SolverGel
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.signals.dots import profile_options
from taccel_lab.signals.gel_faces import face_grid, marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SignalTactile

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


class SensorTactile:
    """Looks at one gel. Arrays are of the host, in the frame of the gel, one for each reading."""

    def __init__(
        self,
        solver: SolverGel,
        gel: str,
        *,
        world: int = 0,
        profile: SensorProfile | None = None,
        size_px: tuple[int, int] = (80, 60),
        markers_mm: Any = None,
    ) -> None:
        """
        Args:
            solver: Whose gel it is.
            gel: Name of the gel.
            world: Of newton's, which is looked at.
            profile: The sensor that the gel is of: its pixels, colours and untouched image.
            size_px: Width and height of a gel without a profile: pixels that fill its contact face.
            markers_mm: Places of markers on the face [mm], [marker, 2]; a grid of 8 x 6 over
                the pixels when None.

        Raises:
            InputError: A gel or a world that is not there, a profile with another mesh, a marker
                beside it.
        """
        names = [mount.gel.name for mount in solver.gel_scene.mounts]
        require_known("gel", gel, names)
        if not 0 <= world < solver.gel_model.env_count:
            raise InputError(
                f"there is no world {world}; there are 0 to {solver.gel_model.env_count - 1}"
            )
        self._solver, self._world = solver, world
        self._index = names.index(gel)
        body = solver.gel_scene.mounts[self._index].gel
        mesh = body.nodal_mesh
        self._nodes = solver.gel_model.bodies[self._index].node_slice
        first = self._nodes.start
        if profile is not None and profile.mesh.node_count != body.mesh.node_count:
            raise InputError(
                f"gel {gel!r} has {body.mesh.node_count} nodes, that of the profile "
                f"{profile.mesh.node_count}: give the profile to BodyGel, too"
            )
        grid = face_grid(mesh, size_px) if profile is None else profile.grid()
        points = np.asarray(
            marker_points_mm(grid) if markers_mm is None else markers_mm, dtype=np.float64
        )
        layout, on_face = MarkerLayout.where_on(mesh, points)
        if markers_mm is not None and not on_face.all():
            raise InputError(f"marker {np.argmin(on_face)} lies beside the face of gel {gel!r}")
        options: dict[str, Any] = {
            "env_count": solver.gel_model.env_count,
            "markers": layout,
            "first_node": first,
            "device": solver.gel_model.device,
        }
        if profile is None:
            self._signal = SignalTactile(mesh, grid, **options)
        else:
            # The gel's own mesh has more nodes than the profile's where it is quadratic.
            given = profile_options(profile, mesh, options)
            self._signal = SignalTactile(mesh, camera_of(profile), **given)
        self.grid = grid
        """Pixels."""
        self.face_nodes = np.unique(mesh.region_faces(Region.CONTACT))
        """Nodes of the gel on its contact face, [node]: rows of ``points`` and ``forces``."""

    def update(self) -> SensorTactile:
        """Look at the gels as the latest step of the solver left them; before the first one, as
        ``SolverGel.reset`` puts them."""
        state = self._solver.gel_state
        if state is None:
            raise InputError("the gels have no state yet: call SolverGel.reset or step before")
        self._signal.update(state.positions, state.poses[:, self._index])
        self._solver.outputs.update(state)
        self._frame = matrix_of(state.poses.numpy()[self._world, self._index])
        return self

    @property
    def image(self) -> np.ndarray:
        """What the camera sees, RGB, uint8, [height_px, width_px, 3]; InputError for a gel without
        a profile that has colours."""
        return self._signal.rgb.numpy()[self._world].copy()

    @property
    def height_m(self) -> np.ndarray:
        """Height of the contact face [m], float32, [height_px, width_px], NaN beside it."""
        return self._signal.height_m.numpy()[self._world].copy()

    @property
    def markers_px(self) -> np.ndarray:
        """Columns and rows of the markers in the image [px], float32, [marker, 2]."""
        return self._signal.markers_px.numpy()[self._world].copy()

    @property
    def points(self) -> np.ndarray:
        """Nodes of the contact face [m], float64, [node, 3]."""
        state = self._solver.gel_state
        assert state is not None
        world = state.positions.numpy()[self._world, self._nodes][self.face_nodes]
        return (world - self._frame[:3, 3]) @ self._frame[:3, :3]

    @property
    def forces(self) -> np.ndarray:
        """Contact and friction on the nodes of the contact face [N], float64, [node, 3]."""
        outputs = self._solver.outputs
        world = (
            outputs.normal_forces.numpy()[self._world]
            + outputs.friction_forces.numpy()[self._world]
        )
        return world[self._nodes][self.face_nodes] @ self._frame[:3, :3]

    @property
    def wrench(self) -> np.ndarray:
        """Force [N] and torque about the gel's origin [N m] on the gel, float64, [6]."""
        return self._solver.outputs.soft_wrenches().numpy()[self._world, self._index].copy()
