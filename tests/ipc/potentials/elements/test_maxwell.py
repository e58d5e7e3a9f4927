# SPDX-License-Identifier: Apache-2.0
"""A Maxwell branch: derivatives, what it must not resist, and what relaxing takes from it."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.material import MOST_BRANCHES
from taccel_lab.errors import InputError
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.elements.maxwell import MaxwellPotential
from taccel_lab.model import Model
from taccel_lab.profile import bounds
from taccel_lab.scene import Element, Material, MaterialModel, MaxwellBranch, Scene, SoftBody
from taccel_lab.state import no_viscous_strain
from tests.ipc.derivatives import assert_derivatives, assert_momenta_are_kept
from tests.support.blocks import block_mesh
from tests.support.turns import random_turns, strained
from tests.verification.elements import ElementForces

YOUNG, NU = 1e5, 0.42
BRANCH = MaxwellBranch(0.4, 0.5)
MESH = block_mesh((1, 1, 1), (2e-3, 2e-3, 1e-3), jitter=0.2)
KINDS = list(Element)
AT_ONCE_S = 1e-12


def relaxing(
    element: Element = Element.LINEAR,
    env_count: int = 1,
    law: MaterialModel = MaterialModel.NEO_HOOKEAN,
) -> Model:
    ratio = 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    material = Material(YOUNG, NU, model=law, mooney_ratio=ratio, branches=(BRANCH,))
    return Scene(SoftBody(MESH, material, element=element), (), env_count).finalize()


class Branch(ElementForces):
    """The branch alone, and the history it is given."""

    def __init__(self, model: Model) -> None:
        self.part = MaxwellPotential(model, model.elastic[0], BRANCH, 0)
        super().__init__(model, [self.part])
        self.kept = no_viscous_strain(model)

    def hold(self, x: np.ndarray, seconds: float | list[float]) -> None:
        """A step at positions [node, 3], and the begin of one that takes next to no time."""
        self.begin(x, seconds)
        self.end(x)
        self.begin(x, AT_ONCE_S)

    def begin(self, x: np.ndarray, seconds: float | list[float], again: bool = False) -> None:
        count = self.model.env_count
        dts = wp.array(np.broadcast_to(seconds, count).copy(), dtype=wp.float64)
        masks = [wp.full(count, value, dtype=wp.int32) for value in (1, int(again))]
        self.part.begin_step(self._everywhere(x), self.kept, dts, *masks)

    def end(self, x: np.ndarray) -> None:
        everyone = wp.full(self.model.env_count, 1, dtype=wp.int32)
        self.part.end_step(self._everywhere(x), self.kept, everyone)

    def _everywhere(self, x: np.ndarray) -> wp.array:
        return self.nodal(np.repeat(x[None], self.model.env_count, axis=0))


def moved(model: Model, seed: int, amount: float = 5e-5) -> np.ndarray:
    return strained(model.rest_positions.numpy()[0], seed, amount, (1.2, 0.9, 0.85))


@pytest.mark.parametrize("element", KINDS)
def test_gradient_and_hessian_are_the_derivatives(element: Element) -> None:
    count = 6 * relaxing(element).node_count
    model = relaxing(element, count)
    made, x = Branch(model), moved(model, 1)
    made.hold(moved(model, 2), 0.3)
    matrix = made.hessian(np.repeat(x[None], count, axis=0), PSD_NONE)[0]
    assert_derivatives(x, made.free, 1e-8, made.energy, made.gradient, matrix, (1e-3, 0))
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    lifted = made.hessian(np.repeat(0.4 * x[None], count, axis=0), PSD_CLAMP)[0]
    assert np.linalg.eigvalsh(lifted)[0] > -1e-12 * np.abs(lifted).max()


@pytest.mark.parametrize("law", list(MaterialModel))
@pytest.mark.parametrize("element", KINDS)
def test_a_fast_strain_sees_the_solid_times_its_share(element: Element, law: MaterialModel) -> None:
    """Without time to relax; after long enough nothing is left of it."""
    model = relaxing(element, law=law)
    made, solid, x = Branch(model), ElementForces(model), moved(model, 1)
    made.hold(model.rest_positions.numpy()[0], AT_ONCE_S)
    scale = np.abs(solid.gradient(x[None])).max()
    share = BRANCH.relative_modulus
    np.testing.assert_allclose(
        made.gradient(x[None]), share * solid.gradient(x[None]), atol=1e-10 * scale
    )
    made.hold(x, 60 * BRANCH.time_s)
    assert np.abs(made.gradient(x[None])).max() < 1e-10 * scale
    assert made.energy(x[None])[0] < 1e-18


@pytest.mark.parametrize("element", KINDS)
def test_rigid_motion_is_free_and_momenta_are_kept(element: Element) -> None:
    """A body that has relaxed in another shape keeps its energy, and its forces turn with it."""
    model = relaxing(element)
    made, other = Branch(model), moved(model, 4)
    made.hold(moved(model, 3), 0.4)
    turn = random_turns(5, 1)[0]
    rigid = (other @ turn.T + [1e-2, 0, 2e-2])[None]
    forces = made.gradient(other[None])[0]
    scale = np.abs(forces).sum()
    np.testing.assert_allclose(made.energy(rigid), made.energy(other[None]), rtol=1e-9)
    np.testing.assert_allclose(made.gradient(rigid)[0], forces @ turn.T, atol=1e-11 * scale)
    assert_momenta_are_kept(other, forces)
    # Relaxing as it is turned is relaxing, turned.
    made.hold(other, 0.2)
    turned = Branch(model)
    turned.hold(moved(model, 3), 0.4)
    turned.hold(rigid[0], 0.2)
    np.testing.assert_allclose(turned.energy(rigid), made.energy(other[None]), rtol=1e-9)


@pytest.mark.parametrize("law", list(MaterialModel))
def test_relaxing_takes_energy_at_any_strain_and_any_time(law: MaterialModel) -> None:
    model = relaxing(Element.QUADRATIC, law=law)
    made = Branch(model)
    for seed in range(8):
        made.hold(moved(model, seed, 1.5e-4), 0.3)
        x = moved(model, seed + 100, 1.5e-4)
        energies = [made.energy(x[None])[0]]
        for seconds in (1e-12, 1e-3, 0.1, 1.0, 10.0):
            made.hold(x, seconds)
            energies.append(made.energy(x[None])[0])
        assert energies[0] > 1e-8
        assert energies[1] == pytest.approx(energies[0], rel=1e-9)
        assert (np.diff(energies[1:]) < 0).all()


@pytest.mark.parametrize("element", KINDS)
def test_steps_have_their_own_length(element: Element) -> None:
    """In halves of the time as in one."""
    model = relaxing(element, 3)
    made, x = Branch(model), moved(model, 1)
    made.hold(x, [0.2, 0.4, 0.4])
    first = made.energy(np.repeat(x[None], 3, axis=0))
    made.hold(x, [0.2, 1e-9, 1e-9])
    found = made.energy(np.repeat(x[None], 3, axis=0))
    np.testing.assert_allclose(found, found[1], rtol=1e-8)
    assert first[0] > 1.1 * first[1]


@pytest.mark.parametrize("element", KINDS)
def test_a_step_taken_again_is_the_step_to_the_other_end(element: Element) -> None:
    model = relaxing(element)
    start, ends = moved(model, 1), (moved(model, 2), moved(model, 3))
    found = []
    for way in (ends, ends[1:]):
        made = Branch(model)
        made.hold(start, 0.3)
        for number, end in enumerate(way):
            # A step that is taken again may be halved.
            made.begin(start if not number else way[0], 0.4 / (number + 1), again=number > 0)
            made.end(end)
        found.append((made.kept.numpy().copy(), made.gradient(ends[1][None])))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize("element", KINDS)
def test_a_strain_that_grows_evenly_is_followed_however_long_the_step(element: Element) -> None:
    """q(t) = E' tau (1 - exp(-t / tau)) of small strains, in steps of 0.02 to 6 tau."""
    model = relaxing(element)
    rest, rate = model.rest_positions.numpy()[0], 1e-7
    grown = rest * [1, 0, 0]
    reference = ElementForces(model).gradient((rest + rate * grown)[None])[0]
    made, time = Branch(model), 0.0
    for dt in (0.01, 0.1, 3.0, 0.5):
        made.begin(rest + rate * time * grown, dt)
        time += dt
        x = rest + rate * time * grown
        share = BRANCH.relative_modulus * BRANCH.time_s * -np.expm1(-time / BRANCH.time_s)
        scale = np.abs(reference).max()
        np.testing.assert_allclose(
            made.gradient(x[None])[0], share * reference, atol=1e-5 * share * scale
        )
        made.end(x)


def test_an_element_inside_out_does_not_relax() -> None:
    model = relaxing(law=MaterialModel.STABLE_NEO_HOOKEAN)
    made = Branch(model)
    before = made.kept.numpy().copy()
    made.hold(model.rest_positions.numpy()[0] * [1, 1, -1], 0.5)
    np.testing.assert_array_equal(made.kept.numpy(), before)


@pytest.mark.parametrize(
    ("branches", "message"),
    [
        ((MaxwellBranch(0.1, 1.0),) * 4, "at most 3 Maxwell branches"),
        (((0.1, 1.0),), "must hold MaxwellBranch"),
    ],
)
def test_bad_branches_are_refused(branches: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Material(YOUNG, NU, branches=branches)


@pytest.mark.parametrize(("modulus", "seconds"), [(0, 1), (-0.1, 1), (np.nan, 1), (0.1, 0)])
def test_bad_constants_of_a_branch_are_refused(modulus: float, seconds: float) -> None:
    with pytest.raises(InputError, match="of a Maxwell branch must lie in"):
        MaxwellBranch(modulus, seconds)


def test_profiles_state_as_many_branches_as_materials_take() -> None:
    """Neither package knows the other."""
    assert bounds.MOST_BRANCHES == MOST_BRANCHES
