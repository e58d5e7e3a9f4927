# SPDX-License-Identifier: Apache-2.0
"""Preconditioned conjugate gradients on the Newton systems of all environments at once.

For GPUs. The iteration is `warp.optim.linear.cg` on a batched operator; ours are the block product
over the shared pattern and the 3x3 block-Jacobi preconditioner. Environments iterate together, each
with its own step lengths, until all have reached the smallest of the tolerances.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from warp.optim.linear import LinearOperator, cg

from taccel_lab.ipc.linear.extra_blocks import ExtraBlocks
from taccel_lab.ipc.linear.pattern import BlockPattern
from taccel_lab.ipc.linear.report import LinearReport

wp.set_module_options({"enable_backward": False})


@wp.func
def _row_product(
    env: int,
    row: int,
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    codes: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.mat33d),
    x: wp.array2d(dtype=wp.vec3d),
) -> wp.vec3d:
    """Row of A x; a code is 2 * block + 1 for a block of the upper triangle, stored transposed."""
    total = wp.vec3d()
    for k in range(row_starts[row], row_starts[row + 1]):
        code = codes[k]
        block = values[env, code / 2]
        if code % 2 == 1:
            total += x[env, columns[k]] * block
        else:
            total += block * x[env, columns[k]]
    return total


@wp.kernel
def _block_product_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    codes: wp.array(dtype=wp.int32),
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
    total = x[env, row]
    if active[env] != 0:
        total = _row_product(env, row, row_starts, columns, codes, values, x)
    total = alpha * total
    if beta != wp.float64(0.0):
        total += beta * y[env, row]
    z[env, row] = total


@wp.kernel
def _extra_product_kernel(
    active: wp.array(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    places: wp.array2d(dtype=wp.vec2i),
    blocks: wp.array2d(dtype=wp.mat33d),
    x: wp.array2d(dtype=wp.vec3d),
    alpha: wp.float64,
    z: wp.array2d(dtype=wp.vec3d),
):
    """z += alpha E x; the order of the sums, and so their last bits, may vary on a GPU."""
    env, k = wp.tid()
    if active[env] == 0 or k >= counts[env]:
        return
    i = places[env, k][0]
    j = places[env, k][1]
    block = blocks[env, k]
    wp.atomic_add(z, env, i, alpha * (block * x[env, j]))
    wp.atomic_add(z, env, j, alpha * (x[env, i] * block))


@wp.kernel
def _residual_kernel(
    active: wp.array(dtype=wp.int32),
    b: wp.array2d(dtype=wp.vec3d),
    x: wp.array2d(dtype=wp.vec3d),
    products: wp.array2d(dtype=wp.vec3d),
    squares: wp.array2d(dtype=wp.vec3d),
):
    """squares = |row of b - A x|^2, |row of b|^2 and x . A x, with products = A x."""
    env, row = wp.tid()
    if active[env] == 0:
        squares[env, row] = wp.vec3d()
        return
    r = b[env, row] - products[env, row]
    squares[env, row] = wp.vec3d(
        wp.dot(r, r), wp.dot(b[env, row], b[env, row]), wp.dot(x[env, row], products[env, row])
    )


@wp.kernel
def _prepare_kernel(
    diagonal: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.mat33d),
    active: wp.array(dtype=wp.int32),
    rhs: wp.array2d(dtype=wp.vec3d),
    inverses: wp.array2d(dtype=wp.mat33d),
    b: wp.array2d(dtype=wp.vec3d),
):
    env, row = wp.tid()
    if active[env] == 0:
        inverses[env, row] = wp.identity(n=3, dtype=wp.float64)
        b[env, row] = wp.vec3d()
    else:
        inverses[env, row] = wp.inverse(values[env, diagonal[row]])
        b[env, row] = rhs[env, row]


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
    """Solver of H p = rhs over the lower triangle of ``pattern``, for many threads."""

    def __init__(self, pattern: BlockPattern, env_count: int, device: wp.Device) -> None:
        self._device = device
        self._shape = (env_count, pattern.free_count)
        # Both triangles, so that each row gathers its product without atomics.
        block = np.arange(pattern.block_count, dtype=np.int64)
        upper = pattern.columns < pattern.rows
        row = np.concatenate([pattern.rows, pattern.columns[upper]])
        column = np.concatenate([pattern.columns, pattern.rows[upper]])
        code = np.concatenate([2 * block, 2 * block[upper] + 1])
        order = np.lexsort((column, row))
        starts = np.searchsorted(row[order], np.arange(pattern.free_count + 1))

        def put(array: np.ndarray) -> wp.array:
            return wp.array(array.astype(np.int32), dtype=wp.int32, device=device)

        self._diagonal = put(pattern.diagonal)
        self._full = [put(starts), put(column[order]), put(code[order])]
        self._inverses = wp.zeros(self._shape, dtype=wp.mat33d, device=device)
        self._b = wp.zeros(self._shape, dtype=wp.vec3d, device=device)
        self._squares = wp.zeros(self._shape, dtype=wp.vec3d, device=device)
        self._products = wp.zeros(self._shape, dtype=wp.vec3d, device=device)
        # Warp counts scalar degrees of freedom, three to a node.
        dof_count = 3 * pattern.free_count
        size = env_count * dof_count
        offsets = put(np.arange(env_count + 1) * dof_count)

        def operator(matvec: Any) -> LinearOperator:
            return LinearOperator((size, size), wp.vec3d, device, matvec, offsets, dof_count)

        self._matrix = operator(self._multiply)
        self._preconditioner = operator(self._precondition)
        self._values: wp.array | None = None
        self._active: wp.array | None = None
        self._extra: ExtraBlocks | None = None

    def _grid(self, x: wp.array) -> wp.array:
        return x.reshape(self._shape)

    def _multiply(self, x: wp.array, y: wp.array, z: wp.array, alpha: float, beta: float) -> None:
        wp.launch(
            _block_product_kernel,
            dim=self._shape,
            inputs=[*self._full, self._values, self._active]
            + [self._grid(x), self._grid(y), wp.float64(alpha), wp.float64(beta)],
            outputs=[self._grid(z)],
            device=self._device,
        )
        extra = self._extra
        if extra is not None and extra.max_count:
            wp.launch(
                _extra_product_kernel,
                dim=(self._shape[0], extra.max_count),
                inputs=[self._active, extra.counts, extra.places, extra.values]
                + [self._grid(x), wp.float64(alpha)],
                outputs=[self._grid(z)],
                device=self._device,
            )

    def _precondition(
        self, x: wp.array, y: wp.array, z: wp.array, alpha: float, beta: float
    ) -> None:
        wp.launch(
            _diagonal_product_kernel,
            dim=self._shape,
            inputs=[self._inverses, self._grid(x), self._grid(y)]
            + [wp.float64(alpha), wp.float64(beta)],
            outputs=[self._grid(z)],
            device=self._device,
        )

    def solve(
        self,
        values: wp.array,
        extra: ExtraBlocks,
        rhs: wp.array,
        solution: wp.array,
        active: wp.array,
        tolerances: wp.array,
        max_iterations: int,
    ) -> LinearReport:
        """See ``LinearSystem.solve``; all active environments report the common iterations."""
        self._values, self._active, self._extra = values, active, extra
        wp.launch(
            _prepare_kernel,
            dim=self._shape,
            inputs=[self._diagonal, values, active, rhs],
            outputs=[self._inverses, self._b],
            device=self._device,
        )
        solution.zero_()
        running = active.numpy() != 0
        iterations = np.zeros(len(running), dtype=np.int64)
        if running.any():
            count, _, _ = cg(
                self._matrix,
                self._b.flatten(),
                solution.flatten(),
                tol=float(tolerances.numpy()[running].min()),
                atol=0.0,
                maxiter=max_iterations,
                M=self._preconditioner,
                check_every=8,
            )
            iterations[running] = int(count)
        self._multiply(solution, solution, self._products, 1.0, 0.0)
        wp.launch(
            _residual_kernel,
            dim=self._shape,
            inputs=[active, self._b, solution, self._products],
            outputs=[self._squares],
            device=self._device,
        )
        r_sq, b_sq, curvature = np.moveaxis(self._squares.numpy().sum(axis=1), -1, 0)
        ratio = np.divide(r_sq, b_sq, out=np.zeros_like(b_sq), where=b_sq != 0)
        # An early stop of one environment is not visible from outside the batched iteration, but
        # an indefinite matrix shows in the sign of x . A x, or the residual is not finite.
        broken = running & (b_sq != 0) & ~(np.isfinite(r_sq) & (curvature >= 0))
        if broken.any():
            x = solution.numpy()
            x[broken] = 0.0
            solution.assign(x)
            iterations[broken], ratio[broken] = 0, 1.0
        return LinearReport(
            iterations=iterations, relative_residual=np.sqrt(ratio), breakdown=broken
        )
