# SPDX-License-Identifier: Apache-2.0
"""Neo-Hookean stress and (projected) Hessian against differences and a dense eigensolver."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.eigen import symmetric_eigen_3x3
from taccel_lab.ipc.elasticity.neo_hookean import (
    PSD_CLAMP,
    PSD_NONE,
    neo_hookean_energy,
    neo_hookean_hessian,
    neo_hookean_piola,
    principal_block,
)

wp.set_module_options({"enable_backward": False})

MU, LAM = 2.0, 30.0


@wp.kernel
def _material_kernel(
    f: wp.array(dtype=wp.mat33d),
    mu: wp.float64,
    lam: wp.float64,
    mode: int,
    energy: wp.array(dtype=wp.float64),
    stress: wp.array(dtype=wp.mat33d),
    blocks: wp.array3d(dtype=wp.mat33d),
):
    n = wp.tid()
    energy[n] = neo_hookean_energy(f[n], mu, lam)
    stress[n] = neo_hookean_piola(f[n], mu, lam)
    h = neo_hookean_hessian(f[n], mu, lam, mode)
    for i in range(3):
        for j in range(3):
            # Columns of V^T: the shape gradients are the unit vectors.
            beta_i = wp.vec3d(h.v[i, 0], h.v[i, 1], h.v[i, 2])
            beta_j = wp.vec3d(h.v[j, 0], h.v[j, 1], h.v[j, 2])
            blocks[n, i, j] = principal_block(h, beta_i, beta_j)


@wp.kernel
def _eigen_kernel(
    a: wp.array(dtype=wp.mat33d),
    values: wp.array(dtype=wp.vec3d),
    vectors: wp.array(dtype=wp.mat33d),
):
    n = wp.tid()
    eigenvalues, v = symmetric_eigen_3x3(a[n])
    values[n] = eigenvalues
    vectors[n] = v


def _evaluate(f: np.ndarray, mode: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies, stresses and 9x9 Hessians; index 3 a + i belongs to F[a, i]."""
    n = len(f)
    energy = wp.zeros(n, dtype=wp.float64, device="cpu")
    stress = wp.zeros(n, dtype=wp.mat33d, device="cpu")
    blocks = wp.zeros((n, 3, 3), dtype=wp.mat33d, device="cpu")
    inputs = [wp.array(f, dtype=wp.mat33d, device="cpu"), MU, LAM, mode]
    wp.launch(_material_kernel, n, inputs=inputs, outputs=[energy, stress, blocks], device="cpu")
    hessian = blocks.numpy().transpose(0, 3, 1, 4, 2).reshape(n, 9, 9)
    return energy.numpy(), stress.numpy(), hessian


def _deformations(kind: str) -> np.ndarray:
    rng = np.random.default_rng(7)
    turns = np.linalg.qr(rng.normal(size=(60, 3, 3)))[0]
    turns *= np.sign(np.linalg.det(turns))[:, None, None]
    scale = {"small": 1e-3, "large": 0.35}.get(kind)
    if scale is not None:
        f = np.eye(3) + scale * rng.normal(size=(400, 3, 3))
        return f[np.linalg.det(f) > 0.05]
    # Equal singular values, and volume gain that makes the stretches indefinite.
    stretches = {
        "rigid": [1.0, 1.0, 1.0],
        "swollen": [1.3, 1.3, 1.3],
        "blown": [2.5, 1.1, 1.1],
        "squeezed": [0.2, 0.9, 1.5],
    }[kind]
    return np.einsum("nij,j,nkj->nik", turns, np.array(stretches), np.roll(turns, 1, axis=0))


KINDS = ["small", "large", "rigid", "swollen", "blown", "squeezed"]


@pytest.mark.parametrize("kind", KINDS)
def test_stress_and_hessian_are_derivatives(kind: str) -> None:
    f = _deformations(kind)[:60]
    _, stress, hessian = _evaluate(f, PSD_NONE)
    step = 1e-5
    for a in range(3):
        for i in range(3):
            change = np.zeros((3, 3))
            change[a, i] = step
            up, down = _evaluate(f + change, PSD_NONE), _evaluate(f - change, PSD_NONE)
            scale = np.abs(hessian).max()
            slope = (up[0] - down[0]) / (2 * step)
            np.testing.assert_allclose(stress[:, a, i], slope, rtol=0, atol=1e-6 * scale)
            column = ((up[1] - down[1]) / (2 * step)).reshape(len(f), 9)
            np.testing.assert_allclose(hessian[:, 3 * a + i], column, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("kind", KINDS)
def test_projection_equals_a_dense_one(kind: str) -> None:
    f = _deformations(kind)
    exact = _evaluate(f, PSD_NONE)[2]
    values, vectors = np.linalg.eigh(exact)
    expected = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0), vectors)
    scale = np.abs(exact).max()
    np.testing.assert_allclose(_evaluate(f, PSD_CLAMP)[2], expected, rtol=0, atol=1e-11 * scale)


def test_the_cases_cover_every_kind_of_negative_mode() -> None:
    negative = {
        kind: (np.linalg.eigvalsh(_evaluate(_deformations(kind), 0)[2]) < 0) for kind in KINDS
    }
    assert negative["large"].any() and negative["squeezed"].any()
    # Six flips and stretches are negative when swollen: only the three twists are not.
    assert negative["swollen"].sum(axis=1).min() >= 5


@pytest.mark.parametrize("spread", [0.0, 1e-14, 1e-8, 1e-3, 1.0, 1e6])
def test_eigenvectors_are_orthonormal_for_any_spectrum(spread: float) -> None:
    rng = np.random.default_rng(11)
    q = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    wanted = 1.0 + spread * rng.random((200, 3))
    a = np.einsum("nij,nj,nkj->nik", q, wanted, q)
    a = 0.5 * (a + a.swapaxes(1, 2))
    values = wp.zeros(200, dtype=wp.vec3d, device="cpu")
    vectors = wp.zeros(200, dtype=wp.mat33d, device="cpu")
    matrices = wp.array(a, dtype=wp.mat33d, device="cpu")
    wp.launch(_eigen_kernel, 200, inputs=[matrices], outputs=[values, vectors], device="cpu")
    w, v = values.numpy(), vectors.numpy()
    scale = np.abs(a).max()
    np.testing.assert_allclose(np.einsum("nij,nik->njk", v, v) - np.eye(3), 0, atol=1e-14)
    np.testing.assert_allclose(np.einsum("nij,nj,nkj->nik", v, w, v), a, rtol=0, atol=1e-14 * scale)
    np.testing.assert_allclose(np.sort(w), np.linalg.eigvalsh(a), rtol=0, atol=1e-14 * scale)
