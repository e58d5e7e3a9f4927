# SPDX-License-Identifier: Apache-2.0
"""Elastic energy of a mesh: gradient and matrix against finite differences, projection, momenta."""

from __future__ import annotations

from itertools import pairwise

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
from tests.ipc.derivatives import assert_derivatives, assert_semidefinite
from tests.support.blocks import block_mesh
from tests.support.turns import strained
from tests.support.variants import variants
from tests.verification.elements import ElementForces

STEP = 1e-8
SIZE = (2e-3, 2e-3, 1e-3)
MESH = block_mesh((1, 1, 1), SIZE)
ROUGH = block_mesh((2, 2, 1), SIZE, 0.2)
TET = TetMesh(
    np.array([[0, 0, 0], [1e-3, 0, 0], [2e-4, 1e-3, 0], [3e-4, 2e-4, 1e-3]]),
    np.array([[0, 1, 2, 3]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    np.zeros(4),
)
FREE = TimeStepping(quasi_static=False)
NEO_HOOKEAN = MaterialModel.NEO_HOOKEAN
every_element = pytest.mark.parametrize("element", list(Element))
every_law = pytest.mark.parametrize("law", list(MaterialModel))


def gel(
    mesh: TetMesh,
    element: Element,
    law: MaterialModel = NEO_HOOKEAN,
    poisson: float = 0.4,
    rest_m: np.ndarray | None = None,
    bonded: np.ndarray | None = None,
) -> SoftBody:
    ratio = 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    material = Material(1e5, poisson, model=law, mooney_ratio=ratio)
    return SoftBody(mesh, material, bonded, rest_m, element=element)


class Forces(ElementForces):
    def __init__(
        self, *bodies: SoftBody, env_count: int = 1, time: TimeStepping | None = None
    ) -> None:
        super().__init__(Scene(bodies, (), env_count, time or TimeStepping()).finalize())
        self.rest = self.model.rest_positions.numpy()[0]


def one_tet(
    element: Element = Element.QUADRATIC, law: MaterialModel = NEO_HOOKEAN, count: int = 1
) -> Forces:
    """A tet that nothing holds."""
    body = gel(TET, element, law, 0.3, bonded=np.zeros(0, dtype=int))
    return Forces(body, env_count=count, time=FREE)


@every_law
@every_element
@pytest.mark.parametrize("poisson", variants([0.49], [0.3, 0.49]))
def test_gradient_and_hessian_are_the_derivatives(
    element: Element, law: MaterialModel, poisson: float
) -> None:
    corners = block_mesh((1, 1, 1), SIZE, jitter=0.0).nodes_m
    # Rest shapes differ from the mesh, and stay straight-edged.
    rest = corners + np.random.default_rng(1).uniform(-1e-4, 1e-4, corners.shape)
    count = 6 * len(Forces(gel(MESH, element)).rest)
    rests = np.repeat(rest[None], count, axis=0)
    made = Forces(gel(MESH, element, law, poisson, rests), env_count=count)
    x = strained(made.rest, 2, 2e-5)
    hessian = made.hessian(np.repeat(x[None], count, axis=0), PSD_NONE)[0]
    assert_derivatives(x, STEP, made.energy, made.gradient, hessian, made.free, (1e-3, 1))


@every_element
def test_one_element_has_no_spurious_modes(element: Element) -> None:
    """Six rigid motions cost nothing, all other motions do."""
    made = one_tet(element)
    values = np.linalg.eigvalsh(made.hessian(made.rest[None], PSD_NONE)[0])
    assert np.abs(values[:6]).max() < 1e-12 * values[-1] and values[6] > 1e-3 * values[-1]


@every_element
def test_environments_use_their_own_rest_shape(element: Element) -> None:
    rests = np.stack([block_mesh((2, 2, 1), SIZE, 0.2, seed).nodes_m for seed in range(3)])
    together = Forces(gel(ROUGH, element, rest_m=rests), env_count=3)
    shapes = together.model.rest_positions.numpy()
    shuffled = shapes[[1, 2, 0]]
    energies = together.energy(shuffled)
    assert np.abs(together.energy(shapes)).max() < 1e-12 * energies.min()
    alone = Forces(gel(ROUGH, element, rest_m=rests[2:]))
    assert alone.energy(shapes[:1])[0] == energies[2]
    np.testing.assert_array_equal(alone.gradient(shapes[:1])[0], together.gradient(shuffled)[2])


@every_law
@every_element
def test_projected_matrix_is_positive_and_differs_where_it_must(
    element: Element, law: MaterialModel
) -> None:
    made = Forces(gel(ROUGH, element, law))
    # A compressed block: without projection the matrix is indefinite.
    x = (strained(made.rest, 3, 5e-5) * 0.7)[None]
    exact, projected = (made.hessian(x, mode)[0] for mode in (PSD_NONE, PSD_CLAMP))
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact)[0] < -1e-3 * scale
    # Clamped, a St. Venant-Kirchhoff solid this crushed has modes without any stiffness.
    assert np.linalg.eigvalsh(projected)[0] > -1e-12 * scale
    # Quadratic elements leave the pressure of a compressed body out, which is indefinite.
    if element is Element.LINEAR or law is MaterialModel.ST_VENANT_KIRCHHOFF:
        assert np.linalg.eigvalsh(projected - exact)[0] > -1e-10 * scale


@every_element
@every_law
def test_energy_of_a_small_strain_keeps_its_digits(law: MaterialModel, element: Element) -> None:
    """The line search compares changes of the energy that are small against E * volume."""
    made = Forces(gel(MESH, element, law, poisson=0.3))
    material = made.model.scene.soft_bodies[0].material
    modulus = float(material.lame_lambda_pa + 2 * material.shear_modulus_pa)
    for strain in (1e-3, 1e-6, 1e-9):
        linear = 0.5 * modulus * strain**2 * np.prod(SIZE)
        energy = made.energy((made.rest + strain * made.rest * [1, 0, 0])[None])[0]
        # The next order of the energy is of relative size strain; F = I + H keeps 1e-16 / strain.
        assert energy == pytest.approx(linear, rel=3 * strain + 2e-14 / strain)


def test_bodies_of_one_law_and_element_share_a_group() -> None:
    field = MaterialField(np.linspace(1e5, 2e5, 12), 0.3)
    long = block_mesh((2, 1, 1), SIZE)
    bodies = [
        gel(MESH, Element.LINEAR),
        SoftBody(long, field, name="second", element=Element.LINEAR),
        gel(MESH, Element.QUADRATIC),
    ]
    made = Forces(*bodies)
    assert [group.bodies for group in made.model.elastic] == [[(0, 0, 6), (1, 6, 18)], [(2, 0, 6)]]
    x = strained(made.rest, 4, 2e-5)
    parts = [Forces(body) for body in bodies]
    ends = np.cumsum([0] + [len(part.rest) for part in parts])
    pairs = list(zip(parts, [x[None, low:high] for low, high in pairwise(ends)], strict=True))
    energy = sum(part.energy(piece)[0] for part, piece in pairs)
    assert made.energy(x[None])[0] == pytest.approx(energy, rel=1e-14)
    gradient = np.concatenate([part.gradient(piece)[0] for part, piece in pairs])
    np.testing.assert_allclose(made.gradient(x[None])[0], gradient, rtol=1e-13, atol=1e-18)
    whole, start = made.hessian(x[None], PSD_CLAMP)[0], 0
    for part, piece in pairs:
        block = part.hessian(piece, PSD_CLAMP)[0]
        rows = slice(start, start + len(block))
        np.testing.assert_allclose(whole[rows, rows], block, atol=1e-12 * np.abs(block).max())
        assert (whole[rows, rows.stop :] == 0).all()
        start = rows.stop


@every_element
def test_motion_of_the_mount_pulls_on_the_free_nodes(element: Element) -> None:
    """Right-hand side: minus the matrix times the motion of the bonded nodes."""
    body = SoftBody(ROUGH, Material(1e5, 0.4), element=element, mount="finger")
    made = ElementForces(Scene(body, KinematicBody(None, name="finger")).finalize())
    x = strained(made.model.rest_positions.numpy()[0], 6, 2e-5)
    bonded = np.setdiff1d(np.arange(len(x)), made.free)
    motion = np.zeros_like(x)
    motion[bonded] = np.random.default_rng(7).normal(size=(len(bonded), 3))
    _, rhs = made.system(x[None], PSD_NONE, motion[None])
    change = made.gradient((x + 1e-7 * motion)[None]) - made.gradient((x - 1e-7 * motion)[None])
    expected = -change[0, made.free] / 2e-7
    assert np.abs(expected).max() > 1
    np.testing.assert_allclose(rhs[0], expected, atol=1e-6 * np.abs(expected).max())
    # A gel without a mount has nothing to gather.
    assert len(Forces(gel(ROUGH, element)).model.elastic[0].gather.rim_rows) == 0


def squeezed_corner(
    ratio: float, law: MaterialModel = NEO_HOOKEAN, count: int = 1
) -> tuple[Forces, np.ndarray]:
    """One tet whose middle node is moved so that J at corner 0 is ``ratio``, and its positions."""
    made = one_tet(law=law, count=count)
    x = made.rest.copy()
    # dx/dl at the corner is 4 (middle - corner) - (end - corner): along one edge, times the ratio.
    middle = made.model.scene.soft_bodies[0].nodal_mesh.tets[0, 7]
    x[middle] = x[0] + (x[3] - x[0]) * (1 + ratio) / 4
    return made, np.repeat(x[None], count, axis=0)


def test_guard_and_its_derivatives() -> None:
    def energy(*arguments) -> float:
        made, x = squeezed_corner(*arguments)
        return made.energy(x)[0]

    energies = [energy(ratio) for ratio in (0.5, 0.1, 1e-3, 1e-6)]
    assert (np.diff(energies) > 0).all() and np.isfinite(energies).all()
    assert np.isposinf(energy(-1e-6))
    # Laws that bear inversion have no guard.
    assert np.isfinite(energy(-0.2, MaterialModel.STABLE_NEO_HOOKEAN))
    made, same = squeezed_corner(0.08, count=60)
    exact, lifted = (made.hessian(same, mode)[0] for mode in (PSD_NONE, PSD_CLAMP))
    off = (2e-6, 2e-6)
    assert_derivatives(same[0], STEP, made.energy, made.gradient, exact, made.free, within=off)
    assert_semidefinite(lifted)


def test_energy_is_infinite_wherever_a_tet_is_inside_out() -> None:
    """Not only at the points where an energy is summed; where J is large it is finite."""
    count = 300
    made = one_tet(count=count)
    x = np.repeat(made.rest[None], count, axis=0)
    middles = made.model.scene.soft_bodies[0].nodal_mesh.tets[0, 4:]
    spread = 0.11 * np.ptp(made.rest, axis=0).max()
    x[:, middles] += np.random.default_rng(3).normal(0, spread, size=(count, 6, 3))
    smallest = smallest_ratios(made.parts, wp.array(x, dtype=wp.vec3d))
    infinite = np.isposinf(made.energy(x))
    assert 30 < (smallest <= 0).sum() < count - 30 and infinite[smallest <= 0].all()
    assert not infinite[smallest > 0.5].any()
