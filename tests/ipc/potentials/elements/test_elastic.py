# SPDX-License-Identifier: Apache-2.0
"""Elastic energy of a mesh: gradient and matrix against finite differences, projection, momenta."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.elements.inversion import smallest_ratios
from taccel_lab.scene import (
    Element,
    KinematicBody,
    Material,
    MaterialField,
    MaterialModel,
    Scene,
    SoftBody,
    TimeStepping,
)
from tests.ipc.derivatives import assert_derivatives
from tests.support.blocks import block_mesh
from tests.support.turns import strained
from tests.support.variants import variants
from tests.verification.elements import ElementForces

STEP = 1e-8
SIZE = (2e-3, 2e-3, 1e-3)
MESH = block_mesh((1, 1, 1), SIZE)
TET = TetMesh(
    np.array([[0, 0, 0], [1e-3, 0, 0], [2e-4, 1e-3, 0], [3e-4, 2e-4, 1e-3]]),
    np.array([[0, 1, 2, 3]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    np.zeros(4),
)
KINDS = list(Element)
LAWS = list(MaterialModel)


def gel(
    mesh: TetMesh,
    element: Element,
    law: MaterialModel = MaterialModel.NEO_HOOKEAN,
    poisson: float = 0.4,
    rest_m: np.ndarray | None = None,
    bonded: np.ndarray | None = None,
) -> SoftBody:
    ratio = 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    material = Material(1e5, poisson, model=law, mooney_ratio=ratio)
    return SoftBody(mesh, material, bonded, rest_m, element=element)


def forces(*bodies: SoftBody, env_count: int = 1) -> ElementForces:
    return ElementForces(Scene(bodies, env_count=env_count).finalize())


def rest_of(made: ElementForces) -> np.ndarray:
    return made.model.rest_positions.numpy()[0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", KINDS)
@pytest.mark.parametrize("poisson", variants([0.49], [0.3, 0.49]))
def test_gradient_and_hessian_are_the_derivatives(
    element: Element, law: MaterialModel, poisson: float
) -> None:
    corners = block_mesh((1, 1, 1), SIZE, jitter=0.0)
    # Rest shapes differ from the mesh, and stay straight-edged.
    rest = corners.nodes_m + np.random.default_rng(1).uniform(-1e-4, 1e-4, corners.nodes_m.shape)
    count = 6 * forces(gel(MESH, element)).model.node_count
    made = forces(
        gel(MESH, element, law, poisson, np.repeat(rest[None], count, axis=0)), env_count=count
    )
    x = strained(rest_of(made), 2, 2e-5)
    hessian = made.hessian(np.repeat(x[None], count, axis=0), PSD_NONE)[0]
    assert_derivatives(x, made.free, STEP, made.energy, made.gradient, hessian, (1e-3, 1))
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-12 * np.abs(hessian).max())


@pytest.mark.parametrize("element", KINDS)
def test_one_element_has_no_spurious_modes(element: Element) -> None:
    """Six rigid motions cost nothing, all other motions do."""
    body = gel(TET, element, poisson=0.3, bonded=np.zeros(0, dtype=int))
    made = ElementForces(Scene(body, time=TimeStepping(quasi_static=False)).finalize())
    values = np.linalg.eigvalsh(made.hessian(rest_of(made)[None], PSD_NONE)[0])
    assert np.abs(values[:6]).max() < 1e-12 * values[-1]
    assert values[6] > 1e-3 * values[-1]


@pytest.mark.parametrize("element", KINDS)
def test_environments_use_their_own_rest_shape(element: Element) -> None:
    mesh = block_mesh((2, 2, 1), SIZE)
    rests = np.stack([block_mesh((2, 2, 1), SIZE, 0.2, seed).nodes_m for seed in range(3)])
    together = forces(gel(mesh, element, rest_m=rests), env_count=3)
    shapes = together.model.rest_positions.numpy()
    at_rest = together.energy(shapes)
    shuffled = together.energy(shapes[[1, 2, 0]])
    assert np.abs(at_rest).max() < 1e-12 * shuffled.min()
    alone = forces(gel(mesh, element, rest_m=rests[2:]))
    assert alone.energy(shapes[:1])[0] == shuffled[2]
    np.testing.assert_array_equal(
        alone.gradient(shapes[:1])[0], together.gradient(shapes[[1, 2, 0]])[2]
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", KINDS)
def test_projected_matrix_is_positive_and_differs_where_it_must(
    element: Element, law: MaterialModel
) -> None:
    mesh = block_mesh((2, 2, 1), SIZE, 0.2)
    made = forces(gel(mesh, element, law))
    # A compressed block: without projection the matrix is indefinite.
    x = (strained(rest_of(made), 3, 5e-5) * 0.7)[None]
    exact = made.hessian(x, PSD_NONE)[0]
    projected = made.hessian(x, PSD_CLAMP)[0]
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact)[0] < -1e-3 * scale
    # Clamped, a St. Venant-Kirchhoff solid this crushed has modes without any stiffness.
    assert np.linalg.eigvalsh(projected)[0] > -1e-12 * scale
    # Quadratic elements leave the pressure of a compressed body out, which is indefinite.
    if element is Element.LINEAR or law is MaterialModel.ST_VENANT_KIRCHHOFF:
        assert np.linalg.eigvalsh(projected - exact)[0] > -1e-10 * scale


@pytest.mark.parametrize("element", KINDS)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("strain", [1e-3, 1e-6, 1e-9])
def test_energy_of_a_small_strain_keeps_its_digits(
    strain: float, law: MaterialModel, element: Element
) -> None:
    """The line search compares changes of the energy that are small against E * volume."""
    made = forces(gel(MESH, element, law, poisson=0.3))
    material = made.model.scene.soft_bodies[0].material
    rest = rest_of(made)
    modulus = material.lame_lambda_pa + 2 * material.shear_modulus_pa
    linear = 0.5 * float(modulus) * strain**2 * np.prod(SIZE)
    # The next order of the energy is of relative size strain; F = I + H keeps 1e-16 / strain.
    assert made.energy((rest + strain * rest * [1, 0, 0])[None])[0] == pytest.approx(
        linear, rel=3 * strain + 2e-14 / strain
    )


def test_bodies_of_one_law_and_element_share_a_group() -> None:
    first = gel(MESH, Element.LINEAR)
    second = SoftBody(
        block_mesh((2, 1, 1), SIZE),
        MaterialField(np.linspace(1e5, 2e5, 12), 0.3),
        name="second",
        element=Element.LINEAR,
    )
    third = gel(MESH, Element.QUADRATIC)
    made = forces(first, second, third)
    assert [group.bodies for group in made.model.elastic] == [[(0, 0, 6), (1, 6, 18)], [(2, 0, 6)]]
    rest = rest_of(made)
    x = strained(rest, 4, 2e-5)
    parts = [forces(body) for body in (first, second, third)]
    ranges = np.cumsum([0] + [part.model.node_count for part in parts])
    separate = [
        (part.energy(x[None, low:high])[0], part.gradient(x[None, low:high])[0])
        for part, low, high in zip(parts, ranges[:-1], ranges[1:], strict=True)
    ]
    assert made.energy(x[None])[0] == pytest.approx(sum(e for e, _ in separate), rel=1e-14)
    np.testing.assert_allclose(
        made.gradient(x[None])[0], np.concatenate([g for _, g in separate]), rtol=1e-13, atol=1e-18
    )
    blocks = [
        part.hessian(x[None, low:high], PSD_CLAMP)[0]
        for part, low, high in zip(parts, ranges[:-1], ranges[1:], strict=True)
    ]
    whole = made.hessian(x[None], PSD_CLAMP)[0]
    start = 0
    for block in blocks:
        rows = slice(start, start + len(block))
        np.testing.assert_allclose(whole[rows, rows], block, atol=1e-12 * np.abs(block).max())
        assert (whole[rows, rows.stop :] == 0).all()
        start = rows.stop


@pytest.mark.parametrize("element", KINDS)
def test_motion_of_the_mount_pulls_on_the_free_nodes(element: Element) -> None:
    """Right-hand side: minus the matrix times the motion of the bonded nodes."""
    mesh = block_mesh((2, 2, 1), SIZE, 0.2)
    body = SoftBody(mesh, Material(1e5, 0.4), element=element, mount="finger")
    scene = Scene(body, KinematicBody(None, name="finger"))
    made = ElementForces(scene.finalize())
    rest = rest_of(made)
    x = strained(rest, 6, 2e-5)
    bonded = np.setdiff1d(np.arange(len(rest)), made.free)
    motion = np.zeros_like(x)
    motion[bonded] = np.random.default_rng(7).normal(size=(len(bonded), 3))
    _, rhs = made.system(x[None], PSD_NONE, motion[None])
    change = made.gradient((x + 1e-7 * motion)[None]) - made.gradient((x - 1e-7 * motion)[None])
    expected = -change[0, made.free] / 2e-7
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(rhs[0], expected, atol=1e-6 * np.abs(expected).max())
    # A gel without a mount has nothing to gather.
    assert len(forces(gel(mesh, element)).model.elastic[0].gather.rim_rows) == 0


def squeezed_corner(law: MaterialModel, ratio: float, count: int = 1) -> tuple:
    """One tet whose middle nodes are moved so that J at corner 0 is ``ratio``, and its forces."""
    body = gel(TET, Element.QUADRATIC, law, bonded=np.zeros(0, dtype=int))
    made = ElementForces(Scene(body, (), count, TimeStepping(quasi_static=False)).finalize())
    x = rest_of(made).copy()
    middle = body.nodal_mesh.tets[0, 7]
    # dx/dl at the corner is 4 (middle - corner) - (end - corner): along one edge, times the ratio.
    x[middle] = x[0] + (x[3] - x[0]) * (1 + ratio) / 4
    return made, x


def test_guard_and_its_derivatives() -> None:
    law = MaterialModel.NEO_HOOKEAN
    energies = []
    for ratio in (0.5, 0.1, 1e-3, 1e-6):
        made, x = squeezed_corner(law, ratio)
        energies.append(made.energy(x[None])[0])
    assert energies[0] < energies[1] < energies[2] < energies[3] < np.inf
    made, x = squeezed_corner(law, -1e-6)
    assert np.isposinf(made.energy(x[None])[0])
    # Laws that bear inversion have no guard.
    made, x = squeezed_corner(MaterialModel.STABLE_NEO_HOOKEAN, -0.2)
    assert np.isfinite(made.energy(x[None])[0])

    made, x = squeezed_corner(law, 0.08, 60)
    same = np.repeat(x[None], 60, axis=0)
    hessian = made.hessian(same, PSD_NONE)[0]
    off = (2e-6, 2e-6)
    assert_derivatives(x, made.free, STEP, made.energy, made.gradient, hessian, within=off)
    lifted = made.hessian(same, PSD_CLAMP)[0]
    assert np.linalg.eigvalsh(lifted)[0] > -1e-12 * np.abs(lifted).max()


def test_energy_is_infinite_wherever_a_tet_is_inside_out() -> None:
    """Not only at the points where an energy is summed; where J is large it is finite."""
    body = gel(TET, Element.QUADRATIC, MaterialModel.NEO_HOOKEAN, bonded=np.zeros(0, dtype=int))
    count = 300
    made = ElementForces(Scene(body, (), count, TimeStepping(quasi_static=False)).finalize())
    rest = rest_of(made)
    side = np.ptp(rest, axis=0).max()
    x = np.repeat(rest[None], count, axis=0)
    middles = body.nodal_mesh.tets[0, 4:]
    x[:, middles] += np.random.default_rng(3).normal(0, 0.11 * side, size=(count, 6, 3))
    smallest = smallest_ratios(made.parts, wp.array(x, dtype=wp.vec3d))
    infinite = np.isposinf(made.energy(x))
    inside_out = smallest <= 0
    assert 30 < inside_out.sum() < count - 30
    assert infinite[inside_out].all()
    assert not infinite[smallest > 0.5].any()
