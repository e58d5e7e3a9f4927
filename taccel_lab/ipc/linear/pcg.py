# SPDX-License-Identifier: Apache-2.0
"""Preconditioned conjugate gradients on the Newton system of all environments at once.

The iteration is `warp.optim.linear.cg` on a batched operator; ours are the block product over the
shared pattern and the 3x3 block-Jacobi preconditioner.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from warp.optim.linear import CG, LinearOperator, cg

from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _block_product_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.mat33d),
    active: wp.array(dtype=wp.int32),
    x: wp.array2d(dtype=wp.vec3d),
    y: wp.array2d(dtype=wp.vec3d),
    alpha: wp.float64,
    beta: wp.float64,
    z: wp.array2d(dtype=wp.vec3d),
):
    """z = alpha A x + beta y; rows of environments at rest are the identity."""
    env, row = wp.tid()
    total = wp.vec3d()
    if active[env] == 0:
        total = x[env, row]
    else:
        for k in range(row_starts[row], row_starts[row + 1]):
            total += values[env, k] * x[env, columns[k]]
    total = alpha * total
    if beta != wp.float64(0.0):
        total += beta * y[env, row]
    z[env, row] = total


@wp.kernel
def _diagonal_inverse_kernel(
    diagonal: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.mat33d),
    active: wp.array(dtype=wp.int32),
    inverses: wp.array2d(dtype=wp.mat33d),
):
    env, row = wp.tid()
    if active[env] == 0:
        inverses[env, row] = wp.identity(n=3, dtype=wp.float64)
    else:
        inverses[env, row] = wp.inverse(values[env, diagonal[row]])


@wp.kernel
def _diagonal_product_kernel(
    inverses: wp.array2d(dtype=wp.mat33d),
    x: wp.array2d(dtype=wp.vec3d),
    y: wp.array2d(dtype=wp.vec3d),
    alpha: wp.float64,
    beta: wp.float64,
    z: wp.array2d(dtype=wp.vec3d),
):
    env, row = wp.tid()
    total = alpha * (inverses[env, row] * x[env, row])
    if beta != wp.float64(0.0):
        total += beta * y[env, row]
    z[env, row] = total


class BlockJacobiCG:
    """Workspace of the solve H p = rhs."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.values = wp.zeros(
            (model.env_count, model.columns.shape[0]), dtype=wp.mat33d, device=model.device
        )
        """Matrix blocks [N/m], shape [env_count, block_count]."""
        shape = (model.env_count, model.free_count)
        self.rhs = wp.zeros(shape, dtype=wp.vec3d, device=model.device)
        self.solution = wp.zeros(shape, dtype=wp.vec3d, device=model.device)
        self._inverses = wp.zeros(shape, dtype=wp.mat33d, device=model.device)
        self._active = wp.zeros(model.env_count, dtype=wp.int32, device=model.device)
        # Warp counts scalar degrees of freedom, three to a node.
        dof_count = 3 * model.free_count
        size = model.env_count * dof_count
        offsets = wp.array(
            np.arange(model.env_count + 1, dtype=np.int32) * dof_count,
            dtype=wp.int32,
            device=model.device,
        )

        def operator(matvec) -> LinearOperator:
            return LinearOperator(
                (size, size), wp.vec3d, model.device, matvec, offsets, dof_count
            )

        self._matrix = operator(self._multiply)
        self._preconditioner = operator(self._precondition)
        self._solver: CG | None = None

    def _grid(self, x: wp.array) -> wp.array:
        return x.reshape((self.model.env_count, self.model.free_count))

    def _multiply(self, x, y, z, alpha, beta) -> None:
        wp.launch(
            _block_product_kernel,
            dim=self.rhs.shape,
            inputs=[self.model.row_starts, self.model.columns, self.values, self._active]
            + [self._grid(x), self._grid(y), wp.float64(alpha), wp.float64(beta)],
            outputs=[self._grid(z)],
            device=self.model.device,
        )

    def _precondition(self, x, y, z, alpha, beta) -> None:
        wp.launch(
            _diagonal_product_kernel,
            dim=self.rhs.shape,
            inputs=[self._inverses, self._grid(x), self._grid(y)]
            + [wp.float64(alpha), wp.float64(beta)],
            outputs=[self._grid(z)],
            device=self.model.device,
        )

    def solve(self, active: wp.array, relative_tolerance: float, max_iterations: int) -> int:
        """Solve for ``solution`` [m] from ``rhs`` [N]; returns the iterations.

        Environments that are not active get a zero solution.
        """
        wp.copy(self._active, active)
        wp.launch(
            _diagonal_inverse_kernel,
            dim=self.rhs.shape,
            inputs=[self.model.diagonal, self.values, active],
            outputs=[self._inverses],
            device=self.model.device,
        )
        self.solution.zero_()
        if not self.rhs.numpy().any():
            return 0
        iterations, _, _ = cg(
            self._matrix,
            self.rhs.flatten(),
            self.solution.flatten(),
            tol=relative_tolerance,
            atol=0.0,
            maxiter=max_iterations,
            M=self._preconditioner,
            check_every=8,
        )
        return int(iterations)
