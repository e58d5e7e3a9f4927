# SPDX-License-Identifier: Apache-2.0
"""Every material against differences, closed forms and linear elasticity; what they decompose."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.material import MaterialModel
from taccel_lab.ipc.device.matrices import signed_svd_3x3, symmetric_eigen_3x3
from taccel_lab.ipc.elasticity.laws import LAWS, Moduli
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE, principal_block
from tests.ipc.batch import mapped
from tests.support.turns import random_turns

MODELS = list(MaterialModel)
FINITE = [MaterialModel.STABLE_NEO_HOOKEAN, MaterialModel.ST_VENANT_KIRCHHOFF]
MU = 2.0
MODULI = {"mu": MU, "lam": 9.0, "ratio": 0.3}


@cache
def _kernel(model: MaterialModel) -> Any:
    law = LAWS[model]
    energy, piola, hessian = law.energy, law.piola, law.hessian
    module = wp.get_module(f"{__name__}.{model.value}")
    wp.set_module_options({"enable_backward": False}, module=module)

    @wp.kernel(module=module)
    def _evaluate_kernel(
        f: wp.array(dtype=wp.mat33d),
        moduli: Moduli,
        mode: int,
        energies: wp.array(dtype=wp.float64),
        stress: wp.array(dtype=wp.mat33d),
        blocks: wp.array3d(dtype=wp.mat33d),
    ):
        n = wp.tid()
        energies[n] = energy(f[n], moduli, 0)
        stress[n] = piola(f[n], moduli, 0)
        h = hessian(f[n], moduli, 0, mode)
        for i in range(3):
            for j in range(3):
                # Columns of V^T: the shape gradients are the unit vectors.
                beta_i = wp.vec3d(h.v[i, 0], h.v[i, 1], h.v[i, 2])
                beta_j = wp.vec3d(h.v[j, 0], h.v[j, 1], h.v[j, 2])
                blocks[n, i, j] = principal_block(h, beta_i, beta_j)

    return _evaluate_kernel


def evaluate(
    model: MaterialModel, f: np.ndarray, mode: int = PSD_NONE, **changed: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energies, stresses and 9x9 Hessians; index 3 a + i belongs to F[a, i]."""
    n = len(f)
    moduli = Moduli()
    for name, value in (MODULI | changed).items():
        setattr(moduli, name, wp.array([value], dtype=wp.float64, device="cpu"))
    shapes = [(n, wp.float64), (n, wp.mat33d), ((n, 3, 3), wp.mat33d)]
    outputs = [wp.zeros(shape, dtype=dtype, device="cpu") for shape, dtype in shapes]
    inputs = [wp.array(f, dtype=wp.mat33d, device="cpu"), moduli, mode]
    wp.launch(_kernel(model), n, inputs=inputs, outputs=outputs, device="cpu")
    energy, stress, blocks = (array.numpy() for array in outputs)
    return energy, stress, blocks.transpose(0, 3, 1, 4, 2).reshape(n, 9, 9)


STRETCHES = {
    "rigid": [1.0, 1.0, 1.0],
    "swollen": [1.6, 1.6, 1.6],
    "shrunk": [0.4, 0.4, 0.4],
    "equal pair": [1.3, 1.3, 0.8],
    "nearly equal": [1.3, 1.3 + 1e-9, 1.3 - 1e-12],
    "blown": [2.5, 1.1, 1.1],
    "squeezed": [0.2, 0.9, 1.5],
}
INVERTED = {
    "flat": [1.2, 0.7, 0.0],
    "line": [1.2, 0.0, 0.0],
    "point": [0.0, 0.0, 0.0],
    "nearly flat": [1.2, 0.7, 1e-9],
    "nearly a line": [1.2, 1e-8, 1e-8],
    "mirrored": [1.0, 1.0, -1.0],
    "inverted": [1.3, 0.6, -0.4],
    "opposite pair": [0.9, 0.5, -0.5],
}


def deformations(kind: str) -> np.ndarray:
    if kind in ("small", "large"):
        scale = {"small": 1e-3, "large": 0.35}[kind]
        f = np.eye(3) + scale * np.random.default_rng(7).normal(size=(200, 3, 3))
        return f[np.linalg.det(f) > 0.05][:60]
    s = np.array({**STRETCHES, **INVERTED}[kind])
    return np.einsum("nij,j,nkj->nik", random_turns(3, 60), s, random_turns(4, 60))


CASES = [*product(MODELS, ["small", "large", *STRETCHES]), *product(FINITE, INVERTED)]


@pytest.mark.parametrize(("model", "kind"), CASES)
def test_stress_and_hessian_are_derivatives_and_projected_as_a_dense_one(
    model: MaterialModel, kind: str
) -> None:
    f = deformations(kind)
    energy, stress, hessian = evaluate(model, f)
    assert np.isfinite(energy).all() and np.isfinite(stress).all()
    step = 1e-5
    # Crushed to a point a stable Neo-Hookean solid has no stiffness, and is the only one.
    crushed = kind == "point" and model is MaterialModel.STABLE_NEO_HOOKEAN
    assert (np.abs(hessian).max() == 0) if crushed else (np.abs(hessian).max() > MU / 2)
    scale = max(np.abs(hessian).max(), MU)
    for k, change in enumerate(step * np.eye(9).reshape(9, 3, 3)):
        up, down = evaluate(model, f + change), evaluate(model, f - change)
        slope, column = (
            (a - b).reshape(len(f), -1) / (2 * step) for a, b in zip(up, down[:2], strict=False)
        )
        off = 2e-8 * scale
        np.testing.assert_allclose(stress.reshape(-1, 9)[:, k], slope[:, 0], rtol=0, atol=off)
        np.testing.assert_allclose(hessian[:, k], column, rtol=0, atol=off)
    np.testing.assert_allclose(hessian, hessian.swapaxes(1, 2), rtol=0, atol=1e-13 * scale)
    stress_free = kind in ("rigid", "point")
    # St. Venant-Kirchhoff knows C only: a mirror image is at rest.
    stress_free |= kind == "mirrored" and model is MaterialModel.ST_VENANT_KIRCHHOFF
    if not stress_free:
        assert np.abs(stress).max() > 1e-4 * scale
    values, vectors = np.linalg.eigh(hessian)
    expected = np.einsum("nij,nj,nkj->nik", vectors, np.maximum(values, 0), vectors)
    projected = evaluate(model, f, PSD_CLAMP)[2]
    np.testing.assert_allclose(projected, expected, rtol=0, atol=1e-12 * scale)
    assert np.linalg.eigvalsh(projected).min() > -1e-13 * scale


@pytest.mark.parametrize("model", MODELS)
def test_the_cases_have_something_to_project(model: MaterialModel) -> None:
    f = np.concatenate([deformations(kind) for m, kind in CASES if m is model])
    assert np.linalg.eigvalsh(evaluate(model, f)[2]).min() < -0.1 * MU


@pytest.mark.parametrize("model", MODELS)
def test_small_strains_are_linear_elasticity(model: MaterialModel) -> None:
    young, nu, eye = 1.7, 0.43, np.eye(3)
    mu, lam = young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))
    h = 1e-7 * np.random.default_rng(2).uniform(-1, 1, (50, 3, 3))
    strain = 0.5 * (h + h.swapaxes(1, 2))
    linear = 2 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * eye
    energy, stress, _ = evaluate(model, eye + h, mu=mu, lam=lam)
    np.testing.assert_allclose(stress, linear, rtol=0, atol=1e-6 * np.abs(linear).max())
    # The energy keeps its digits, although it is 1e-14 of the modulus.
    expected = 0.5 * np.einsum("nij,nij->n", linear, strain)
    np.testing.assert_allclose(energy, expected, rtol=1e-5)
    assert energy.min() > 0
    # At rest the Hessian is C_ijkl exactly, and nothing is stored.
    c = np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye)
    c = mu * c + lam * np.einsum("ij,kl->ijkl", eye, eye)
    stored, _, hessian = evaluate(model, eye[None], mu=mu, lam=lam)
    np.testing.assert_allclose(hessian[0], c.reshape(9, 9), rtol=0, atol=1e-13 * lam)
    assert stored[0] == 0


@pytest.mark.parametrize("model", MODELS)
def test_rotations_change_nothing_but_the_frame(model: MaterialModel) -> None:
    f = deformations("large")
    left, right = random_turns(5, len(f)), random_turns(6, len(f))
    energy, stress, hessian = evaluate(model, f)
    turned = evaluate(model, left @ f @ right)
    np.testing.assert_allclose(turned[0], energy, rtol=1e-12)
    off = 1e-13 * np.abs(stress).max()
    np.testing.assert_allclose(turned[1], left @ stress @ right, rtol=0, atol=off)
    both = np.einsum("nab,nij->naibj", left, right.swapaxes(1, 2)).reshape(-1, 9, 9)
    expected = both @ hessian @ both.swapaxes(1, 2)
    np.testing.assert_allclose(turned[2], expected, rtol=0, atol=1e-12 * np.abs(hessian).max())
    # A moment-free stress: P F^T is symmetric.
    kirchhoff = stress @ f.swapaxes(1, 2)
    np.testing.assert_allclose(kirchhoff, kirchhoff.swapaxes(1, 2), rtol=0, atol=off)


def test_mooney_rivlin_without_second_invariant_is_neo_hookean() -> None:
    f = np.concatenate([deformations(kind) for kind in ("small", "large", *STRETCHES)])
    plain = evaluate(MaterialModel.NEO_HOOKEAN, f)
    for found, wanted in zip(
        evaluate(MaterialModel.MOONEY_RIVLIN, f, ratio=0.0), plain, strict=True
    ):
        size = np.abs(wanted).reshape(len(f), -1).max(axis=1)
        off = np.abs(found - wanted).reshape(len(f), -1).max(axis=1)
        assert (off <= 1e-13 * np.maximum(size, MU)).all()
    assert np.abs(evaluate(MaterialModel.MOONEY_RIVLIN, f)[1] - plain[1]).max() > 0.1 * MU


def squeezed(parts: np.ndarray) -> np.ndarray:
    return np.array([np.diag([1.0, 1.0, part]) for part in parts])


@pytest.mark.parametrize("model", MODELS)
def test_inversion_costs_infinity_only_where_it_should(model: MaterialModel) -> None:
    # Rotated factors leave a determinant of either sign, so that only exact zeros are flat.
    kinds = [np.diag([1.2, 0.7, 0.0])[None], deformations("mirrored"), deformations("inverted")]
    energy = evaluate(model, np.concatenate(kinds))[0]
    if model in FINITE:
        assert np.isfinite(energy).all()
    else:
        assert np.isposinf(energy).all()
        towards = evaluate(model, squeezed(np.array([1e-1, 1e-3, 1e-6, 1e-12])))[0]
        assert (np.diff(towards) > MU).all() and towards[-1] > 100 * MU


def test_stable_neo_hookean_pushes_back_out_of_inversion() -> None:
    """Energy only grows through the plane and out; a St. Venant-Kirchhoff solid rests mirrored."""
    f = squeezed(np.linspace(1.0, -1.5, 251))
    energy, stress, _ = evaluate(MaterialModel.STABLE_NEO_HOOKEAN, f)
    assert (np.diff(energy) > 0).all() and (stress[1:, 2, 2] < 0).all()
    mirrored = evaluate(MaterialModel.ST_VENANT_KIRCHHOFF, squeezed(np.array([-1.0])))
    assert mirrored[0][0] == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("kind", ["small", "large", *STRETCHES, *INVERTED])
def test_signed_svd(kind: str, scale: float) -> None:
    f = scale * deformations(kind)
    u, s, v = mapped(signed_svd_3x3, f)
    for turn in (u, v):
        np.testing.assert_allclose(turn @ turn.swapaxes(1, 2) - np.eye(3), 0, atol=3e-15)
        np.testing.assert_allclose(np.linalg.det(turn), 1, rtol=1e-14)
    off = 4e-15 * np.abs(f).max()
    np.testing.assert_allclose(np.einsum("nij,nj,nkj->nik", u, s, v), f, rtol=0, atol=off)
    ordered = np.sort(np.abs(s), axis=1)[:, ::-1]
    np.testing.assert_allclose(ordered, np.linalg.svd(f)[1], rtol=0, atol=off)
    if kind not in ("flat", "line", "point"):
        np.testing.assert_array_equal((s < 0).any(axis=1), np.linalg.det(f / scale) < 0)
    assert ((s < 0).sum(axis=1) <= 1).all()


@pytest.mark.parametrize("spread", [0.0, 1e-14, 1e-8, 1e-3, 1.0, 1e6])
def test_eigenvectors_are_orthonormal_for_any_spectrum(spread: float) -> None:
    q, wanted = random_turns(11, 200), 1.0 + spread * np.random.default_rng(11).random((200, 3))
    a = np.einsum("nij,nj,nkj->nik", q, wanted, q)
    a = 0.5 * (a + a.swapaxes(1, 2))
    w, v = mapped(symmetric_eigen_3x3, a)
    off = 1e-14 * np.abs(a).max()
    np.testing.assert_allclose(np.einsum("nij,nik->njk", v, v) - np.eye(3), 0, atol=1e-14)
    np.testing.assert_allclose(np.einsum("nij,nj,nkj->nik", v, w, v), a, rtol=0, atol=off)
    np.testing.assert_allclose(np.sort(w), np.linalg.eigvalsh(a), rtol=0, atol=off)
