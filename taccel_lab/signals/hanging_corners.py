# SPDX-License-Identifier: Apache-2.0
r"""Corners of quadratic elements where the face around them touches.

Of a load that is the same everywhere a corner of a quadratic triangle gets nothing: the integral of
its shape function is zero. So next to nothing holds a corner, and under the ridge of an object it
hangs as much as 40 um below the middles of the edges around it, at edges of 0.25 mm. No pressure
tells of that pit, and no correction of pressures closes it. Where all middles around a corner carry
and it hangs below the paraboloid through them, it goes there, which is off by the third order in
the edges' length.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.geometry import QuadraticMesh, Region
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})

PARABOLOID = 6
"""Numbers that it has."""


@wp.kernel
def _lift_kernel(
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    corners: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    middles: wp.array(dtype=wp.int32),
    shares: wp.array2d(dtype=wp.float64),
    # In and out
    positions: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    total = wp.vec3d()
    load = wp.vec3d()
    for k in range(starts[i], starts[i + 1]):
        gradient = contact_gradient[env, middles[k]]
        if wp.length_sq(gradient) == wp.float64(0.0):
            return
        load -= gradient
        total += shares[env % shares.shape[0], k] * positions[env, middles[k]]
    if wp.dot(positions[env, corners[i]] - total, load) > wp.float64(0.0):
        positions[env, corners[i]] = total


class HangingCorners:
    """Corners of the contact face of one gel of a model; none where its elements are linear."""

    def __init__(self, model: Model, gel: int) -> None:
        body = model.scene.soft_bodies[gel]
        mesh = body.nodal_mesh
        rings = _rings(mesh) if isinstance(mesh, QuadraticMesh) else {}
        first = int(model.bodies[gel].nodes[0])
        middles = np.array([node for ring in rings.values() for node in ring], dtype=np.int32)
        starts = np.cumsum([0, *map(len, rings.values())])
        # Gels of environments may be graded for their own contacts.
        xy = body.nodal_rest_m[..., :2]
        shares = np.empty((len(xy), len(middles)))
        for size in {len(ring) for ring in rings.values()}:
            alike = [i for i, ring in enumerate(rings.values()) if len(ring) == size]
            where = starts[alike][:, None] + np.arange(size)
            corners = np.array(list(rings))[alike]
            shares[:, where] = _shares(xy[:, middles[where]] - xy[:, corners, None])

        def on_device(values: object, dtype: type) -> wp.array:
            return wp.array(np.asarray(values), dtype=dtype, device=model.device)

        self._count = len(rings)
        self._arrays = [
            on_device([first + corner for corner in rings], wp.int32),
            on_device(starts, wp.int32),
            on_device(first + middles, wp.int32),
            on_device(shares, wp.float64),
        ]

    def lift(self, positions: wp.array, contact_gradient: wp.array) -> None:
        """Move corners that hang, all others stay.

        Args:
            positions: Of all nodes [m], vec3d, [env_count, node_count]; in place.
            contact_gradient: Of the contact's energy [N], zero at nodes that do not touch, the
                same type and shape.
        """
        wp.launch(
            _lift_kernel,
            dim=(positions.shape[0], self._count),
            inputs=[contact_gradient, *self._arrays],
            outputs=[positions],
            device=positions.device,
        )


def _rings(mesh: QuadraticMesh) -> dict[int, list[int]]:
    """Middles of all edges of the contact faces around each corner that has enough of them."""
    rings: dict[int, set[int]] = {}
    for parts in mesh.region_faces(Region.CONTACT).reshape(-1, 12):
        a, ab, ca, _, b, bc, _, _, c, *_ = parts.tolist()
        for corner in (a, b, c):
            rings.setdefault(corner, set()).update((ab, bc, ca))
    return {
        corner: sorted(ring) for corner, ring in sorted(rings.items()) if len(ring) > PARABOLOID
    }


def _shares(offsets: np.ndarray) -> np.ndarray:
    """Weights of values at ``offsets`` [..., n, 2] in the least-squares paraboloid through them, at
    (0, 0), [..., n]."""
    x, y = np.moveaxis(offsets / np.abs(offsets).max(axis=(-2, -1), keepdims=True), -1, 0)
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    # Squared, as they are here, a ring on a conic has an eigenvalue of rounding.
    normal = np.linalg.pinv(np.swapaxes(design, -1, -2) @ design, rcond=1e-10, hermitian=True)
    return (design @ normal)[..., 0]
