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
from taccel_lab.profile import bounds
from taccel_lab.scene import Element, Material, MaterialModel, MaxwellBranch, Scene, SoftBody
from taccel_lab.state import no_viscous_strain
from tests.ipc.derivatives import assert_derivatives, assert_semidefinite
from tests.support.blocks import block_mesh
from tests.support.turns import random_turns, strained
from tests.verification.elements import ElementForces

BRANCH = MaxwellBranch(0.4, 0.5)
MESH = block_mesh((1, 1, 1), (2e-3, 2e-3, 1e-3), jitter=0.2)
AT_ONCE_S = 1e-12
every_element = pytest.mark.parametrize("element", list(Element))
every_law = pytest.mark.parametrize("law", list(MaterialModel))


class Branch(ElementForces):
    """The branch alone, and the history it is given."""

    def __init__(
        self,
        element: Element = Element.LINEAR,
        env_count: int = 1,
        law: MaterialModel = MaterialModel.NEO_HOOKEAN,
    ) -> None:
        ratio = 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
        material = Material(1e5, 0.42, model=law, mooney_ratio=ratio, branches=(BRANCH,))
        model = Scene(SoftBody(MESH, material, element=element), (), env_count).finalize()
        self.part = MaxwellPotential(model, model.elastic[0], BRANCH, 0)
        super().__init__(model, [self.part])
        self.kept, self.everyone = no_viscous_strain(model), self.active
        self.rest = model.rest_positions.numpy()[0]

    def moved(self, seed: int, amount: float = 5e-5) -> np.ndarray:
        return strained(self.rest, seed, amount, (1.2, 0.9, 0.85))

    def hold(self, x: np.ndarray, seconds: float | list[float]) -> None:
        """A step at positions [node, 3], and the begin of one that takes next to no time."""
        self.begin(x, seconds)
        self.end(x)
        self.begin(x, AT_ONCE_S)

    def begin(self, x: np.ndarray, seconds: float | list[float], again: bool = False) -> None:
        count = self.model.env_count
        dts = wp.array(np.full(count, seconds), dtype=wp.float64)
        which = wp.full(count, int(again), dtype=wp.int32)
        self.part.begin_step(self.nodal(self.same(x)), self.kept, dts, self.everyone, which)

    def end(self, x: np.ndarray) -> None:
        self.part.end_step(self.nodal(self.same(x)), self.kept, self.everyone)

    def same(self, x: np.ndarray) -> np.ndarray:
        return np.repeat(x[None], self.model.env_count, axis=0)


@every_element
def test_gradient_and_hessian_are_the_derivatives(element: Element) -> None:
    made = Branch(element, 6 * len(Branch(element).rest))
    x = made.moved(1)
    made.hold(made.moved(2), 0.3)
    matrix = made.hessian(made.same(x), PSD_NONE)[0]
    assert_derivatives(x, 1e-8, made.energy, made.gradient, matrix, made.free, (1e-3, 0))
    assert_semidefinite(made.hessian(made.same(0.4 * x), PSD_CLAMP)[0])


@every_law
@every_element
def test_a_fast_strain_sees_the_solid_times_its_share(element: Element, law: MaterialModel) -> None:
    """Without time to relax; after long enough nothing is left of it."""
    made = Branch(element, law=law)
    solid, x = ElementForces(made.model).gradient(made.moved(1)[None]), made.moved(1)
    made.hold(made.rest, AT_ONCE_S)
    off = 1e-10 * np.abs(solid).max()
    np.testing.assert_allclose(made.gradient(x[None]), BRANCH.relative_modulus * solid, atol=off)
    made.hold(x, 60 * BRANCH.time_s)
    assert np.abs(made.gradient(x[None])).max() < off and made.energy(x[None])[0] < 1e-18


@every_element
def test_rigid_motion_is_free_and_momenta_are_kept(element: Element) -> None:
    """A body that has relaxed in another shape keeps its energy, and its forces turn with it."""
    made, turned = Branch(element), Branch(element)
    other = made.moved(4)
    for one in (made, turned):
        one.hold(made.moved(3), 0.4)
    turn = random_turns(5, 1)[0]
    rigid = (other @ turn.T + [1e-2, 0, 2e-2])[None]
    forces = made.gradient(other[None])[0]
    scale = np.abs(forces).sum()
    np.testing.assert_allclose(made.energy(rigid), made.energy(other[None]), rtol=1e-9)
    np.testing.assert_allclose(made.gradient(rigid)[0], forces @ turn.T, atol=1e-11 * scale)
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-13 * scale)
    moment = np.cross(other, forces).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-13 * scale * np.abs(other).max())
    # Relaxing as it is turned is relaxing, turned.
    made.hold(other, 0.2)
    turned.hold(rigid[0], 0.2)
    np.testing.assert_allclose(turned.energy(rigid), made.energy(other[None]), rtol=1e-9)


@every_law
def test_relaxing_takes_energy_at_any_strain_and_any_time(law: MaterialModel) -> None:
    made = Branch(Element.QUADRATIC, law=law)
    for seed in range(8):
        made.hold(made.moved(seed, 1.5e-4), 0.3)
        x = made.moved(seed + 100, 1.5e-4)
        energies = [made.energy(x[None])[0]]
        for seconds in (1e-12, 1e-3, 0.1, 1.0, 10.0):
            made.hold(x, seconds)
            energies.append(made.energy(x[None])[0])
        assert energies[0] > 1e-8 and energies[1] == pytest.approx(energies[0], rel=1e-9)
        assert (np.diff(energies[1:]) < 0).all()


@every_element
def test_steps_have_their_own_length(element: Element) -> None:
    made = Branch(element, 3)
    x = made.moved(1)
    made.hold(x, [0.2, 0.4, 0.4])
    first = made.energy(made.same(x))
    made.hold(x, [0.2, 1e-9, 1e-9])
    found = made.energy(made.same(x))
    np.testing.assert_allclose(found, found[1], rtol=1e-8)
    assert first[0] > 1.1 * first[1]


@every_element
def test_a_step_taken_again_is_the_step_to_the_other_end(element: Element) -> None:
    found = []
    for seeds in ((2, 3), (3,)):
        made = Branch(element)
        made.hold(made.moved(1), 0.3)
        for number, seed in enumerate(seeds):
            # A step that is taken again may be halved.
            made.begin(made.moved(seeds[0] if number else 1), 0.4 / (number + 1), again=number > 0)
            made.end(made.moved(seed))
        found.append((made.kept.numpy().copy(), made.gradient(made.moved(3)[None])))
    for again, at_once in zip(*found, strict=True):
        np.testing.assert_array_equal(again, at_once)


@every_element
def test_a_strain_that_grows_evenly_is_followed_however_long_the_step(element: Element) -> None:
    """q(t) = E' tau (1 - exp(-t / tau)) of small strains, in steps of 0.02 to 6 tau."""
    made, time = Branch(element), 0.0
    way = 1e-7 * made.rest * [1, 0, 0]
    reference = ElementForces(made.model).gradient((made.rest + way)[None])[0]
    for dt in (0.01, 0.1, 3.0, 0.5):
        made.begin(made.rest + time * way, dt)
        time += dt
        x = made.rest + time * way
        share = BRANCH.relative_modulus * BRANCH.time_s * -np.expm1(-time / BRANCH.time_s)
        off = 1e-5 * share * np.abs(reference).max()
        np.testing.assert_allclose(made.gradient(x[None])[0], share * reference, atol=off)
        made.end(x)


def test_an_element_inside_out_does_not_relax() -> None:
    made = Branch(law=MaterialModel.STABLE_NEO_HOOKEAN)
    before = made.kept.numpy().copy()
    made.hold(made.rest * [1, 1, -1], 0.5)
    np.testing.assert_array_equal(made.kept.numpy(), before)


def test_bad_branches_are_refused() -> None:
    for branches, sentence in (
        ((BRANCH,) * 4, "at most 3 Maxwell branches"),
        (((0.1, 1.0),), "branches must be a list, each of it a MaxwellBranch"),
    ):
        with pytest.raises(InputError, match=sentence):
            Material(1e5, 0.42, branches=branches)
    for constants in ((0, 1), (-0.1, 1), (np.nan, 1), (0.1, 0)):
        with pytest.raises(InputError, match="of a Maxwell branch must lie in"):
            MaxwellBranch(*constants)
    # Profiles state as many branches as materials take; neither package knows the other.
    assert bounds.MOST_BRANCHES == MOST_BRANCHES
