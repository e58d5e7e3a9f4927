# SPDX-License-Identifier: Apache-2.0
r"""Nodal gradients of a nodal field on a scattered surface mesh: the least bent network of curves.

Every mesh edge carries the cubic with the end values f and the end slopes ``g . e``. The gradients
g are those of least total bending ``sum_edges int (d^2 f / ds^2)^2 ds``. With e the edge vector
(length L) and Df the rise along it, node a obeys

    sum_edges (e e^T / L^3) (2 g_a + g_b) = 3 sum_edges Df e / L^3

(G. M. Nielson, "A method for interpolating scattered data based upon a minimum norm network",
Math. Comp. 40 (1983) 253-271). Planes are exact. Unlike a patch fit the network bends where the
data bend, so the jump of curvature at a contact's edge does not spread.

Block Jacobi solves it: the blocks on the diagonal outweigh the others 2:1, so its iteration has
all eigenvalues in [-1/2, 1/2], the case of Chebyshev acceleration (G. H. Golub, C. F. Van Loan,
"Matrix Computations", 4th ed., section 11.2.8), which divides the error by T_k(2) in k sweeps.
What a sweep needs of the geometry is computed once, and all sweeps of an environment run in one
thread block, so that a thousand environments cost two launches.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.ipc.device.native import native


@dataclass(frozen=True)
class ContactFaceMesh:
    """Triangulation of the contact faces with its neighbourhoods."""

    node_idx: np.ndarray
    """Tet-mesh node of each surface node, int32, shape [surface_node_count]."""
    faces: np.ndarray
    """Outward triangles in surface numbering, int32, shape [face_count, 3]."""
    edges: np.ndarray
    """Unique edges in surface numbering, int32, shape [edge_count, 2]."""
    ring_start: np.ndarray
    """First entry of each node in ``ring_nodes``, int32, shape [surface_node_count + 1]."""
    ring_nodes: np.ndarray
    """Edge neighbours of each node, int32, shape [2 edge_count]."""

    @property
    def node_count(self) -> int:
        return len(self.node_idx)

    @classmethod
    def from_mesh(cls, mesh: TetMesh | QuadraticMesh) -> ContactFaceMesh:
        """Cut the faces of region CONTACT out of ``mesh``; InputError when there is none."""
        faces = mesh.region_faces(Region.CONTACT)
        if len(faces) == 0:
            raise InputError(
                "TetMesh.face_regions holds no face of region CONTACT; a tactile image needs the "
                f"contact face (value {int(Region.CONTACT)}) to be labelled"
            )
        return cls.from_faces(faces)

    @classmethod
    def from_faces(cls, faces: np.ndarray) -> ContactFaceMesh:
        """Build from triangles in tet-mesh numbering, shape [face_count, 3]."""
        node_idx, local = np.unique(np.asarray(faces), return_inverse=True)
        local = local.reshape(-1, 3).astype(np.int32)
        edges = np.unique(
            np.sort(np.concatenate([local[:, [0, 1]], local[:, [1, 2]], local[:, [2, 0]]]), axis=1),
            axis=0,
        )
        ring_start, ring_nodes = _neighbours(edges, len(node_idx))
        return cls(
            node_idx=node_idx.astype(np.int32),
            faces=local,
            edges=edges.astype(np.int32),
            ring_start=ring_start,
            ring_nodes=ring_nodes,
        )


def _neighbours(edges: np.ndarray, node_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours one edge away, as (start, nodes)."""
    from scipy import sparse

    ones = np.ones(len(edges), dtype=np.int32)
    half = sparse.coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(node_count, node_count))
    ring = sparse.csr_array(half + half.T)
    ring.sort_indices()
    return ring.indptr.astype(np.int32), ring.indices.astype(np.int32)


wp.set_module_options({"enable_backward": False})

SWEEPS = 17
"""1 / T_17(2) = 4e-10 of the initial error stays, far below the interpolation error."""
FEW_SWEEPS = 11
"""Leaves 1e-6, the rounding of FP32 slopes."""
# Square of the spectral radius of the Jacobi iteration.
_RADIUS2 = wp.constant(wp.float64(0.25))
# Few environments at a time on a multiprocessor, whose cache then holds their terms.
_BLOCK_DIM = 512


@wp.func_native(native("gradient_recovery", "block_barrier"))
def block_barrier():
    """Wait for the other threads of the block; on the CPU a block is one thread."""
    ...


@wp.kernel
def _network_terms_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    values: wp.array2d(dtype=wp.float64),
    ring_start: wp.array(dtype=wp.int32),
    ring_nodes: wp.array(dtype=wp.int32),
    # Out
    arms: wp.array2d(dtype=wp.vec2d),
    inverses: wp.array2d(dtype=wp.mat22d),
    alone: wp.array2d(dtype=wp.vec2d),
    gradients: wp.array3d(dtype=wp.vec2d),
):
    """The block row of each node: ``g_a = alone - inverse sum_b arm (arm . g_b)``."""
    env, node = wp.tid()
    origin = positions[env, node]
    value = values[env, node]
    matrix = wp.mat22d()
    rhs = wp.vec2d()
    for entry in range(ring_start[node], ring_start[node + 1]):
        other = ring_nodes[entry]
        p = positions[env, other]
        edge = wp.vec2d(p[0] - origin[0], p[1] - origin[1])
        length = wp.length(edge)
        arm = wp.vec2d()
        if length > wp.float64(0.0):
            # Its outer product with itself is e e^T / L^3.
            arm = edge / (length * wp.sqrt(length))
            matrix = matrix + wp.float64(2.0) * wp.outer(arm, arm)
            rise = wp.float64(3.0) * (values[env, other] - value)
            rhs = rhs + rise / (length * wp.sqrt(length)) * arm
        arms[env, entry] = arm
    det = wp.determinant(matrix)
    trace = wp.trace(matrix)
    inverse = wp.mat22d()
    if det > wp.float64(1e-12) * trace * trace:
        inverse = wp.inverse(matrix)
    elif trace > wp.float64(0.0):
        # All edges in one line: the slope across it is open, take the least one.
        one = wp.float64(1.0) / trace
        inverse = wp.mat22d(one, wp.float64(0.0), wp.float64(0.0), one)
    inverses[env, node] = inverse
    alone[env, node] = inverse * rhs
    # Zeros, and what the first sweep makes of them.
    gradients[0, env, node] = wp.vec2d()
    gradients[1, env, node] = inverse * rhs


@wp.kernel
def _relax_gradients_kernel(
    ring_start: wp.array(dtype=wp.int32),
    ring_nodes: wp.array(dtype=wp.int32),
    arms: wp.array2d(dtype=wp.vec2d),
    inverses: wp.array2d(dtype=wp.mat22d),
    alone: wp.array2d(dtype=wp.vec2d),
    sweeps: int,
    # Out
    gradients: wp.array3d(dtype=wp.vec2d),
):
    """All further sweeps of an environment, by one thread block."""
    env, lane = wp.tid()
    node_count = alone.shape[1]
    omega = wp.float64(2.0) / (wp.float64(2.0) - _RADIUS2)
    for sweep in range(2, sweeps + 1):
        new = sweep % 2
        for node in range(lane, node_count, wp.block_dim()):
            total = wp.vec2d()
            for entry in range(ring_start[node], ring_start[node + 1]):
                arm = arms[env, entry]
                total += wp.dot(arm, gradients[1 - new, env, ring_nodes[entry]]) * arm
            jacobi = alone[env, node] - inverses[env, node] * total
            before = gradients[new, env, node]
            gradients[new, env, node] = before + omega * (jacobi - before)
        omega = wp.float64(4.0) / (wp.float64(4.0) - _RADIUS2 * omega)
        block_barrier()


@dataclass(frozen=True)
class NetworkScratch:
    """Device memory that ``recover_gradients`` works in, for up to ``env_count`` environments."""

    arms: wp.array
    """Edge over its length^1.5, vec2d, shape [env, ring entry]."""
    inverses: wp.array
    alone: wp.array
    gradients: wp.array
    """Two sweeps, vec2d, shape [2, env, node]."""

    @classmethod
    def empty(
        cls, env_count: int, node_count: int, entry_count: int, device: Any
    ) -> NetworkScratch:
        """Allocate; ``entry_count`` is the length of the ring's node list."""
        nodal = (env_count, node_count)
        return cls(
            arms=wp.empty((env_count, entry_count), dtype=wp.vec2d, device=device),
            inverses=wp.empty(nodal, dtype=wp.mat22d, device=device),
            alone=wp.empty(nodal, dtype=wp.vec2d, device=device),
            gradients=wp.empty((2, *nodal), dtype=wp.vec2d, device=device),
        )


def recover_gradients(
    positions: Any,
    values: Any,
    ring_start: Any,
    ring_nodes: Any,
    scratch: NetworkScratch | None = None,
    sweeps: int = SWEEPS,
) -> Any:
    """Gradient over xy of a nodal field.

    Args:
        positions: Nodes [m], Warp array of vec3d, shape [env, node]; only xy is used.
        values: Field, Warp float64 array, shape [env, node].
        ring_start: Offsets of each node's edge neighbours, Warp int32 array, shape [node + 1].
        ring_nodes: Those neighbours, Warp int32 array.
        scratch: Memory to work in, for at least as many environments; allocated when None.
        sweeps: Of the iteration, at least 2.

    Returns:
        Warp array of vec2d, shape [env, node], unit of ``values`` per metre; part of ``scratch``.
    """
    device = values.device
    env_count, node_count = values.shape
    if scratch is None:
        scratch = NetworkScratch.empty(env_count, node_count, len(ring_nodes), device)
    wp.launch(
        _network_terms_kernel,
        dim=values.shape,
        inputs=[positions, values, ring_start, ring_nodes],
        outputs=[scratch.arms, scratch.inverses, scratch.alone, scratch.gradients],
        device=device,
    )
    wp.launch_tiled(
        _relax_gradients_kernel,
        dim=[env_count],
        inputs=[ring_start, ring_nodes, scratch.arms, scratch.inverses, scratch.alone, sweeps],
        outputs=[scratch.gradients],
        block_dim=_BLOCK_DIM,
        device=device,
    )
    return scratch.gradients[sweeps % 2][:env_count]
