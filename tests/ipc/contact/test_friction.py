# SPDX-License-Identifier: Apache-2.0
"""The friction of a contact: smoothing against ipctk, at rest, and tangent frames."""

from __future__ import annotations

import ipctk
import numpy as np
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.contact import friction
from taccel_lab.ipc.device.matrices import tangent_basis
from tests.ipc.batch import Array, mapped, unit

EPS_U, MU_LAMBDA = 1e-3, 0.7


@wp.func
def friction_terms(
    weights: wp.vec4d, n: wp.vec3d, dx0: wp.vec3d, dx1: wp.vec3d, dx2: wp.vec3d, dx3: wp.vec3d,
    mu_lambda: wp.float64, eps_u: wp.float64,
):  # fmt: skip
    """(f0, f1/u, f2), |u|, potential, gradient and Hessian by the relative displacement."""
    u = friction.tangential(n, friction.relative_displacement(weights, dx0, dx1, dx2, dx3))
    size = wp.length(u)
    smoothing = wp.vec3d(
        friction.friction_f0(size, eps_u),
        friction.friction_f1_over_u(size, eps_u),
        friction.friction_f2(size, eps_u),
    )
    value = friction.friction_potential(u, mu_lambda, eps_u)
    gradient = friction.friction_gradient(u, mu_lambda, eps_u)
    hessian = friction.friction_hessian(n, u, mu_lambda, eps_u, wp.float64(1.0))
    return smoothing, size, value, gradient, hessian


def test_smoothing_equals_ipctk_and_rest_is_its_limit() -> None:
    """Displacements spread over 1e-3 .. 1e3 of eps_u; those of the first 100 contacts are none."""
    rng, count = np.random.default_rng(0), 1000
    weights = np.concatenate([np.ones((count, 1)), -rng.dirichlet(np.ones(3), size=count)], axis=1)
    n = unit(rng.normal(size=(count, 3)))
    dx = rng.normal(size=(4, count, 3)) * EPS_U * 10.0 ** rng.uniform(-3, 3, (count, 1))
    dx[:, :100] = 0.0
    terms = mapped(friction_terms, weights, n, *dx, MU_LAMBDA, EPS_U)
    smoothing, size, value, gradient, hessian = terms
    assert 200 < np.sum(size < EPS_U) < 900
    for column, name in enumerate(("f0", "f1_over_x", "f2")):
        expected = [getattr(ipctk, f"smooth_friction_{name}")(u, EPS_U) for u in size]
        np.testing.assert_allclose(smoothing[:, column], expected, rtol=1e-12, atol=1e-15)
    lowest = np.linalg.eigvalsh(hessian)
    assert np.all(lowest[:, 0] >= -1e-12 * lowest[:, -1])
    np.testing.assert_allclose(value[:100], MU_LAMBDA * EPS_U / 3)
    assert not gradient[:100].any()
    plane = np.eye(3) - n[:100, :, None] * n[:100, None, :]
    np.testing.assert_allclose(hessian[:100], 2 * MU_LAMBDA / EPS_U * plane, rtol=1e-12, atol=1e-9)


@wp.func
def parabola_above(u: wp.vec3d, v: wp.vec3d, eps: wp.float64) -> wp.float64:
    """Parabola at u evaluated at v, less the potential at v."""
    one = wp.float64(1.0)
    normal = wp.vec3d(wp.float64(0.0), wp.float64(0.0), one)
    h = friction.friction_hessian(normal, u, one, eps, wp.float64(0.0))
    step = v - u
    slope = friction.friction_gradient(u, one, eps) + wp.float64(0.5) * (h * step)
    parabola = friction.friction_potential(u, one, eps) + wp.dot(slope, step)
    return parabola - friction.friction_potential(v, one, eps)


@given(seed=st.integers(0, 2**31), scale=st.floats(0.01, 100.0))
def test_the_parabola_lies_above_the_potential(seed: int, scale: float) -> None:
    eps = 1e-6
    u, v = scale * eps * np.random.default_rng(seed).normal(size=(2, 64, 3)) * [1, 1, 0]
    assert (mapped(parabola_above, u, v, eps) >= -1e-14 * scale * eps).all()


def test_tangent_basis_is_a_right_handed_frame_everywhere() -> None:
    axes = [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1, 0, -0.0]]
    nearly = [[1e-9, 0, -1], [0, 1e-200, 1], [-1e-200, 0, -1]]
    n: Array = unit(np.concatenate([np.random.default_rng(5).normal(size=(2000, 3)), axes, nearly]))
    frame = np.concatenate([mapped(tangent_basis, n), n[:, None]], axis=1)
    np.testing.assert_allclose(frame @ frame.transpose(0, 2, 1) - np.eye(3), 0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, rtol=1e-14)
