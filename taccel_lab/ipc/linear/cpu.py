# SPDX-License-Identifier: Apache-2.0
"""Conjugate gradients with a symmetric Gauss-Seidel preconditioner: one thread an environment.

For the CPU. A whole solve is one kernel, so an iteration costs no launch, and an environment that
is at rest or has converged costs nothing and never sees the others: its result is bitwise the same
alone and in a batch.

With A = L + D + L^T (D the 3x3 diagonal blocks) and B = D / w + L the preconditioner is
B D^-1 B^T. CG runs on B^-1 A B^-T: as A = B + B^T - (2 / w - 1) D, its product with p is t + u,
where B^T t = p and B u = p - (2 / w - 1) D t [Eisenstat 1981, Efficient implementation of a class
of preconditioned conjugate gradient methods]. Two triangular sweeps over the stored lower triangle
are both the matrix product and the preconditioner. Extra blocks E outside of the pattern enter the
product only: u gains B^-1 E t. Blocks of D that are not positive definite are turned (``turned``),
and E takes that out of the product.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.extra_rows import ExtraRowLists, ExtraRows
from taccel_lab.ipc.linear.problem.turned import (
    reach_m,
    shortened,
    turned_curvature,
    turning,
)
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})

RELAXATION = 1.2
"""w: 5-10 % fewer iterations than 1 on Newton matrices of gel presses, flat from 1.1 to 1.4."""
_CHECK_EVERY = 8


_ROWS = native("linear_cpu", "rows")


@wp.func
def _invert_diagonal(
    row_starts: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    scale: wp.float64,
    inverses: wp.array(dtype=wp.mat33d),
    kept: wp.array(dtype=wp.vec3d),
) -> int:
    """Inverses of the blocks D, scaled. Those that are not positive definite are turned, in the
    matrix too, or B D^-1 B^T would not be either; ``kept``: diagonals before. Returns how many."""
    turned = int(0)
    for i in range(inverses.shape[0]):
        last = row_starts[i + 1] - 1
        block = values[last]
        kept[i] = wp.get_diag(block)
        more = turning(block)
        if wp.length_sq(more) > wp.float64(0.0):
            block += wp.diag(more)
            values[last] = block
            turned += 1
        inverses[i] = scale * wp.inverse(block)
    return turned


@wp.func_native(native("linear_cpu", "forward_sweep", ROWS=_ROWS))
def _forward_sweep(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    inverses: wp.array(dtype=wp.mat33d),
    b: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
) -> None:
    """x = B^-1 b; may be the same array."""
    ...


@wp.func_native(native("linear_cpu", "backward_sweep", ROWS=_ROWS))
def _backward_sweep(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    inverses: wp.array(dtype=wp.mat33d),
    b: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    upper: wp.array(dtype=wp.vec3d),
) -> None:
    """x = B^-T b and upper = L^T x."""
    ...


@wp.func_native(native("linear_cpu", "product_sweep", ROWS=_ROWS))
def _product_sweep(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    inverses: wp.array(dtype=wp.mat33d),
    keep: wp.float64,
    turn: wp.float64,
    p: wp.array(dtype=wp.vec3d),
    t: wp.array(dtype=wp.vec3d),
    e: wp.array(dtype=wp.vec3d),
    u: wp.array(dtype=wp.vec3d),
) -> wp.float64:
    """u = B^-1 (keep p + turn u + e), where u = L^T t before; returns p . (t + u)."""
    ...


@wp.func_native(native("linear_cpu", "move", ROWS=_ROWS))
def _move(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    alpha: wp.float64,
    way: wp.float64,
    t: wp.array(dtype=wp.vec3d),
    x: wp.array(dtype=wp.vec3d),
    r: wp.array(dtype=wp.vec3d),
    u: wp.array(dtype=wp.vec3d),
) -> wp.float64:
    """x += way t, r -= alpha (t + u) and u = D r; returns r . u."""
    ...


@wp.func_native(native("linear_cpu", "residual_sq", ROWS=_ROWS))
def _residual_sq(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    diagonal_weight: wp.float64,
    r: wp.array(dtype=wp.vec3d),
) -> wp.float64:
    """|B r|^2: the squared norm of the residual that r = B^-1 (b - A x) stands for."""
    ...


@wp.func_native(native("linear_cpu", "subtract_product", ROWS=_ROWS))
def _subtract_product(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.mat33d),
    x: wp.array(dtype=wp.vec3d),
    r: wp.array(dtype=wp.vec3d),
) -> None:
    """r -= (L + D + L^T) x."""
    ...


@wp.func
def _add_extra_product(
    count: int,
    codes: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.vec2i),
    blocks: wp.array(dtype=wp.mat33d),
    x: wp.array(dtype=wp.vec3d),
    y: wp.array(dtype=wp.vec3d),
):
    """y += E x of one environment; every block is listed for both triangles."""
    for e in range(count):
        k = codes[e] / 2
        if codes[e] % 2 == 0:
            y[places[k][0]] += blocks[k] * x[places[k][1]]
        else:
            # x * block = block^T x
            y[places[k][1]] += x[places[k][0]] * blocks[k]


@wp.func
def _sum_sq(x: wp.array(dtype=wp.vec3d)) -> wp.float64:
    total = wp.float64(0.0)
    for i in range(x.shape[0]):
        total += wp.dot(x[i], x[i])
    return total


@wp.kernel
def _solve_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    all_values: wp.array2d(dtype=wp.mat33d),
    extra_rows: ExtraRows,
    all_extra_places: wp.array(dtype=wp.vec2i),
    all_extra_values: wp.array(dtype=wp.mat33d),
    all_rhs: wp.array2d(dtype=wp.vec3d),
    active: wp.array(dtype=wp.int32),
    tolerances: wp.array(dtype=wp.float64),
    max_iterations: int,
    relaxation: wp.float64,
    check_every: int,
    reach: wp.float64,
    all_inverses: wp.array2d(dtype=wp.mat33d),
    all_kept: wp.array2d(dtype=wp.vec3d),
    all_r: wp.array2d(dtype=wp.vec3d),
    all_p: wp.array2d(dtype=wp.vec3d),
    all_t: wp.array2d(dtype=wp.vec3d),
    all_u: wp.array2d(dtype=wp.vec3d),
    all_e: wp.array2d(dtype=wp.vec3d),
    solutions: wp.array2d(dtype=wp.vec3d),
    iterations: wp.array(dtype=wp.int32),
    residuals: wp.array(dtype=wp.float64),
    breakdowns: wp.array(dtype=wp.int32),
):
    env = wp.tid()
    values = all_values[env]
    b = all_rhs[env]
    inverses = all_inverses[env]
    kept = all_kept[env]
    r = all_r[env]
    p = all_p[env]
    t = all_t[env]
    u = all_u[env]
    e = all_e[env]
    extra_count = extra_rows.totals[env, 0]
    first = extra_rows.starts[env][0]
    end = extra_rows.starts[env + 1][0]
    extra_codes = extra_rows.codes[2 * first : 2 * end]
    extra_places = all_extra_places[first:end]
    extra_values = all_extra_values[first:end]
    x = solutions[env]
    n = b.shape[0]
    for i in range(n):
        x[i] = wp.vec3d()
    iterations[env] = 0
    residuals[env] = wp.float64(0.0)
    breakdowns[env] = 0
    if active[env] == 0:
        return
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    b_sq = _sum_sq(b)
    if b_sq == zero:
        return
    for i in range(n):
        e[i] = wp.vec3d()
    goal = tolerances[env] * tolerances[env] * b_sq
    weight = one / relaxation
    # B^T t = p gives p - (2/w - 1) D t = (w - 1) p + (2 - w) L^T t.
    keep = relaxation - one
    turn = wp.float64(2.0) - relaxation

    turned = _invert_diagonal(row_starts, values, relaxation, inverses, kept)
    _forward_sweep(row_starts, columns, values, inverses, b, r)
    rho = zero
    for i in range(n):
        z = values[row_starts[i + 1] - 1] * r[i]
        rho += wp.dot(r[i], z)
        p[i] = z
    # CG knows |r|^2 in the metric of D; the true norm follows at checks, by this ratio between.
    ratio = b_sq / rho
    # Of the direction, in the metric of the preconditioner.
    length_sq = rho
    count = int(0)
    unchecked = int(0)
    searching = int(1)
    if not (rho > zero and b_sq < wp.float64(wp.inf)):
        breakdowns[env] = 1
        searching = int(0)
    while searching == 1 and count < max_iterations:
        _backward_sweep(row_starts, columns, values, inverses, p, t, u)
        if extra_count + turned > 0:
            for i in range(n):
                less = kept[i] - wp.get_diag(values[row_starts[i + 1] - 1])
                e[i] = wp.cw_mul(less, t[i])
            _add_extra_product(extra_count, extra_codes, extra_places, extra_values, t, e)
        curvature = _product_sweep(row_starts, columns, values, inverses, keep, turn, p, t, e, u)
        if not (curvature > zero and curvature < wp.float64(wp.inf)):
            breakdowns[env] = 1
        if curvature == zero or not wp.isfinite(curvature):
            searching = int(0)
        else:
            alpha = rho / curvature
            # The recurrence solves the system; what it takes down is turned.
            way = rho / turned_curvature(curvature, length_sq)
            rho_new = _move(row_starts, columns, values, alpha, way, t, x, r, u)
            beta = rho_new / rho
            rho = rho_new
            length_sq = rho + beta * beta * length_sq
            for i in range(n):
                p[i] = u[i] + beta * p[i]
            count += 1
            unchecked += 1
            if ratio * rho <= goal or unchecked == check_every:
                unchecked = int(0)
                r_sq = _residual_sq(row_starts, columns, values, weight, r)
                if r_sq <= goal:
                    searching = int(0)
                ratio = r_sq / rho
    if breakdowns[env] != 0:
        square = zero
        descent = zero
        for i in range(n):
            square += wp.length_sq(x[i])
            descent += wp.dot(x[i], b[i])
        part = shortened(square, descent, reach)
        for i in range(n):
            x[i] = part * x[i]
        if part == zero:
            count = int(0)
    if turned > 0:
        for i in range(n):
            last = row_starts[i + 1] - 1
            block = values[last]
            for k in range(3):
                block[k, k] = kept[i][k]
            values[last] = block
    iterations[env] = count
    for i in range(n):
        e[i] = wp.vec3d()
    _add_extra_product(extra_count, extra_codes, extra_places, extra_values, x, e)
    for i in range(n):
        r[i] = b[i] - e[i]
    _subtract_product(row_starts, columns, values, x, r)
    residuals[env] = wp.sqrt(_sum_sq(r) / b_sq)


class SsorCG:
    """Solver of H p = rhs over the lower triangle of the pattern, on the CPU."""

    description = "CG with symmetric Gauss-Seidel, one kernel"

    def __init__(self, problem: LinearProblem, clusters: list[tuple[int, int]]) -> None:
        """``clusters``: ranges of rows of affine bodies."""
        self._problem = problem
        pattern, device = problem.pattern, problem.device
        if not device.is_cpu:
            raise InputError("linear_method ssor is for the CPU; a GPU has arrow, cg and pipelined")
        self._row_starts = wp.array(pattern.row_starts, dtype=wp.int32, device=device)
        self._columns = wp.array(pattern.columns, dtype=wp.int32, device=device)
        self._extra = ExtraRowLists(problem)
        self._reach = reach_m(problem, clusters)
        self._inverses = wp.zeros(problem.shape, dtype=wp.mat33d, device=device)
        self._work = [wp.zeros(problem.shape, dtype=wp.vec3d, device=device) for _ in range(6)]

    def solve(self, active: wp.array, max_iterations: int) -> None:
        """See ``LinearSystem.solve``."""
        p = self._problem
        self._extra.update(active)
        inputs = [self._row_starts, self._columns, p.values, self._extra.rows, p.extra.places]
        inputs += [p.extra.values, p.rhs, active, p.tolerances, max_iterations]
        inputs += [wp.float64(RELAXATION), _CHECK_EVERY, wp.float64(self._reach), self._inverses]
        inputs += [*self._work, p.solution]
        launch(_solve_kernel, p.env_count, *inputs, p.iterations, p.residuals, p.breakdown)
