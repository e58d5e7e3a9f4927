# SPDX-License-Identifier: Apache-2.0
"""Parameters by environment: each environment is that of a model built with its values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh, free_block
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    MaterialField,
    MaterialModel,
    Plane,
    RevoluteJoint,
    Scene,
    SoftBody,
    StatedMass,
    Surface,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import Control, SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import everywhere, pose
from tests.support.scene_steps import Stepped, in_time, linear

PAD = block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3))
TETS = PAD.tet_count
TOOL = sphere_mesh(2e-3, 1e-3)
START_Z = 2.1e-3
YOUNG = np.array([5e4, 1e5, 2e5])
POISSON = np.array([0.3, 0.4, 0.45])
FRICTION = np.array([0.0, 0.5, 1.0])
GEL = Material(1e5, 0.4)
MOONEY = Material(1e5, 0.4, model=MaterialModel.MOONEY_RIVLIN, mooney_ratio=0.3)


def pad_under_tool(
    env_count: int,
    material: Material | MaterialField,
    element: Element = Element.LINEAR,
    friction: float = 0.7,
) -> Scene:
    gel = SoftBody(PAD, material, name="pad", element=element)
    return Scene(gel, KinematicBody(TOOL, friction, name="tool"), env_count)


class Arrays(Stepped):
    def result(self) -> list[np.ndarray]:
        solver, state = self.solver, self.state
        forces = [solver.contact_gradient, solver.friction_gradient]
        return [array.numpy().copy() for array in (state.positions, state.velocities, *forces)]


class Pad(Arrays):
    def __init__(
        self,
        env_count: int = 1,
        material: Material | MaterialField = GEL,
        element: Element = Element.LINEAR,
        friction: float = 0.7,
        **config: Any,
    ) -> None:
        made = pad_under_tool(env_count, material, element, friction)
        super().__init__(made, pose(0, 0, START_Z), **config)

    def press(self) -> list[np.ndarray]:
        start = everywhere(self.model.env_count, pose(0, 0, START_Z))
        self.state = initial_state(self.model, start)
        for x in (0, 1e-4):
            self.step(pose(x, 0, START_Z - 2.5e-4))
        return self.result()


def assert_same(found: list[np.ndarray], env: int, expected: list[np.ndarray]) -> None:
    for value, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(value[env], other[0])
    assert np.abs(expected[2]).max() > 2e-5, "the bodies were meant to touch"


@pytest.mark.thorough(cases=("material1-quadratic", "material2-quadratic"))
@pytest.mark.parametrize(
    ("material", "element"),
    [(GEL, Element.LINEAR), (GEL, Element.QUADRATIC), (MOONEY, Element.QUADRATIC)],
)
def test_a_press_is_that_of_a_built_model(material: Material, element: Element) -> None:
    """Bitwise: modulus, Poisson's ratio, friction, and the stiffness of the contact with them."""
    run = Pad(3, material, element)
    run.model.set_body("pad", young_modulus_pa=YOUNG, poisson_ratio=POISSON)
    run.model.set_friction("tool", "pad", FRICTION)
    found = run.press()
    stress = Outputs(run.solver).update(run.state).von_mises.numpy()
    for env in range(3):
        values = {"young_modulus_pa": YOUNG[env], "poisson_ratio": POISSON[env]}
        alone = Pad(1, replace(material, **values), element, FRICTION[env])
        if not alone.model.rubs:
            # Without any friction a solver leaves it out: the same to the residual.
            continue
        assert_same(found, env, alone.press())
        its_stress = Outputs(alone.solver).update(alone.state).von_mises.numpy()
        np.testing.assert_array_equal(stress[env], its_stress[0])
        # What the line search takes for rounding.
        first, second = (r.solver.progress.search.energy_rounding.numpy() for r in (run, alone))
        assert first[env] == second[0] > 0
    pull = found[3][:, run.nodes(0)].sum(axis=1)
    push = found[2][:, run.nodes(0)].sum(axis=1)
    assert np.abs(pull[0]).max() == 0
    assert push[2, 2] > 3.5 * push[0, 2], "the pads were meant to be stiffer and stiffer"


def test_a_frictionless_environment_is_that_of_a_frictionless_model() -> None:
    run = Pad(2)
    run.model.set_friction("pad", "tool", 0.0)
    force, expected = (
        found[2][0, run.nodes(0)].sum(axis=0) for found in (run.press(), Pad(friction=0.0).press())
    )
    assert np.abs(force - expected).max() < 1e-4 * np.abs(expected).max()


def test_until_they_differ_all_environments_share_one_row() -> None:
    model = Pad(3).model
    group = model.elastic[0]
    arrays = model.masses, model.pair_friction, model.largest_moduli, group.mu, group.lam
    assert [a.shape[0] for a in arrays] == [1, 1, 1, TETS, TETS]
    assert group.young_moduli is None and model.moves == 0
    model.set_friction("pad", "tool", FRICTION)
    assert model.pair_friction.shape[0] == 3 and model.moves == 1
    assert group.mu.shape == (TETS,) and model.masses.shape[0] == 1
    model.set_friction("pad", "tool", 0.1)
    assert model.moves == 1, "written in place from now on"


DAMPED = (MaxwellBranch(1.0, 1e-2),)


class Cubes(Arrays):
    """A damped pad on a shaking mount under an affine cube, and a soft cube on a table."""

    def __init__(
        self,
        env_count: int,
        pad: Material = Material(1e5, 0.4, branches=DAMPED),
        soft: Material = Material(3e5, 0.4, branches=DAMPED),
        density: float = 1000.0,
        **config: Any,
    ) -> None:
        rubs: dict[str, Any] = {"friction_coefficient": 0.5}
        place = pose(8e-3, 0, -7.985e-3)
        gels = [
            linear(PAD, pad, name="pad", mount="hand", surface=Surface(collides_with=0b001)),
            linear(
                free_block((2, 2, 2), 2e-3),
                soft,
                name="soft cube",
                initial_pose=place,
                surface=Surface(layer=0b010),
            ),
        ]
        cube, die = (box_mesh((side, side, side)) for side in (3e-3, 1e-3))
        scene = Scene(
            gels,
            KinematicBody(None, name="hand"),
            env_count,
            in_time(2e-3),
            affine_bodies=[
                AffineBody(
                    cube, density, name="cube", initial_pose=pose(0.2e-3, 0, 1.52e-3), **rubs
                ),
                AffineBody(die, name="die", initial_pose=pose(-8e-3, 0, -9.485e-3), **rubs),
            ],
            planes=Plane((0, 0, -1e-2), name="table", friction_coefficient=0.3),
        )
        super().__init__(scene, **config)

    def shake(self, first: int, last: int) -> list[np.ndarray]:
        for step in range(first, last):
            self.step(pose(5e-5 * step, 0, 0))
        return self.result()


@pytest.mark.thorough
def test_masses_weights_and_damping_follow_bitwise() -> None:
    densities, young = np.array([500.0, 2000.0]), np.array([2e5, 6e4])
    both = Cubes(2)
    both.model.set_body("soft cube", density_kg_m3=densities)
    both.model.set_body("pad", young_modulus_pa=young)
    found = both.shake(1, 4)
    for env in range(2):
        pad = Material(young[env], 0.4, branches=DAMPED)
        soft = Material(3e5, 0.4, densities[env], branches=DAMPED)
        alone = Cubes(1, pad, soft)
        assert_same(found, env, alone.shake(1, 4))
        # The die on the table is pressed as by a model whose stiffest gel is this one.
        np.testing.assert_array_equal(
            both.solver.collisions.snapshot(env)["stiffnesses"],
            alone.solver.collisions.snapshot(0)["stiffnesses"],
        )
        np.testing.assert_array_equal(both.model.masses.numpy()[env], alone.model.masses.numpy()[0])


def test_lumped_masses_of_quadratic_tets_follow_bitwise() -> None:
    model = pad_under_tool(2, GEL, Element.QUADRATIC).finalize()
    model.set_body("pad", density_kg_m3=[777.0, 1234.5])
    for env, density in enumerate((777.0, 1234.5)):
        built = pad_under_tool(1, replace(GEL, density_kg_m3=density), Element.QUADRATIC).finalize()
        np.testing.assert_array_equal(model.masses.numpy()[env], built.masses.numpy()[0])


@pytest.mark.thorough
@pytest.mark.parametrize("by_mass", [False, True])
def test_affine_bodies_take_density_or_mass(by_mass: bool) -> None:
    """To rounding: mass and moments of the solid are those of the scene times a factor."""
    densities = np.array([300.0, 4000.0])
    exact: dict[str, Any] = {"relative_tolerance": 1e-8, "absolute_tolerance_n": 1e-13}
    both = Cubes(2, **exact)
    value = {"mass_kg": densities * 27e-9} if by_mass else {"density_kg_m3": densities}
    both.model.set_body("cube", **value)
    found = both.shake(1, 4)
    for env in range(2):
        alone = Cubes(1, density=densities[env], **exact)
        expected = alone.shake(1, 4)
        masses = both.model.masses.numpy()[env], alone.model.masses.numpy()[0]
        np.testing.assert_allclose(*masses, rtol=1e-14)
        start = alone.model.affine.first_control
        np.testing.assert_allclose(found[0][env, start], expected[0][0, start], rtol=0, atol=1e-9)
        weight = 9.81 * densities[env] * 27e-9
        push = found[2][env, both.model.bodies[0].node_slice].sum(axis=0)
        assert np.abs(push).max() > 0.2 * weight, "the cube was meant to weigh on the pad"


def pendulum(env_count: int, density: float = 1000.0) -> Stepped:
    link = box_mesh((4e-3, 1e-3, 1e-3))
    scene = Scene(
        affine_bodies=[
            AffineBody(link, density, name="upper", initial_pose=pose(2e-3, 0, 0)),
            AffineBody(link, name="lower", initial_pose=pose(6e-3, 0, 0)),
        ],
        joints=[
            RevoluteJoint("upper", None, (0, 0, 0), (0, 1, 0), name="top"),
            RevoluteJoint("lower", "upper", (4e-3, 0, 0), (0, 1, 0), name="middle"),
        ],
        time=in_time(2e-3),
        env_count=env_count,
    )
    return Stepped(scene, relative_tolerance=1e-8, absolute_tolerance_n=1e-13)


def test_mechanisms_take_masses_whatever_their_penalties() -> None:
    """Of a link twenty times as heavy as the scene's, and of one a twentieth."""
    densities = np.array([50.0, 20000.0])
    run = pendulum(2)
    run.model.set_body("upper", density_kg_m3=densities)
    alone = [pendulum(1, density) for density in densities]
    for each in (run, *alone):
        each.steps(20)
    found = run.state.positions.numpy()
    for env, other in enumerate(alone):
        np.testing.assert_allclose(found[env], other.x(), rtol=0, atol=1e-8)
    assert np.abs(found[0] - found[1]).max() > 1e-4, "the links were meant to swing otherwise"


def test_a_stated_mass_is_set_as_a_mass() -> None:
    stated = StatedMass(0.01, np.array([1e-3, 0, 0]), 1e-7 * np.eye(3))
    cube = AffineBody(box_mesh((4e-3, 4e-3, 4e-3)), name="cube", stated_mass=stated)
    model = Scene(affine_bodies=cube, env_count=2, time=in_time(1e-2, 0.0)).finalize()
    first = model.affine.first_control
    np.testing.assert_allclose(model.masses.numpy()[:, first], 0.01)
    # Moments of the control vectors: tr(I) / 2 - I.
    moments = model.masses.numpy()[0, first + 1 : first + 4] * model.affine.lengths.numpy()[0] ** 2
    np.testing.assert_allclose(moments, 5e-8)
    model.set_body("cube", mass_kg=[0.02, 0.03])
    np.testing.assert_allclose(model.masses.numpy()[:, first], [0.02, 0.03])
    with pytest.raises(InputError, match="'cube' has a stated mass, not a density: set mass_kg"):
        model.set_body("cube", density_kg_m3=500.0)


def test_mass_of_a_soft_body_keeps_how_it_is_spread() -> None:
    densities = np.linspace(500, 2000, TETS)
    model = Pad(2, MaterialField(1e5, 0.4, densities)).model
    before = model.masses.numpy()[0]
    model.set_body("pad", mass_kg=np.array([1e-4, 3e-4]))
    after = model.masses.numpy()
    np.testing.assert_allclose(after.sum(axis=1), [1e-4, 3e-4], rtol=1e-12)
    np.testing.assert_allclose(after[1], before * (3e-4 / before.sum()), rtol=1e-12)
    model.set_body("pad", mass_kg=before.sum())
    np.testing.assert_allclose(model.masses.numpy()[1], before, rtol=1e-12)


def test_moduli_by_tet() -> None:
    young = np.stack([np.linspace(5e4, 1e5, TETS), np.linspace(3e5, 5e4, TETS)])
    run = Pad(2)
    run.model.set_body("pad", young_modulus_pa=young)
    found = run.press()
    for env in range(2):
        assert_same(found, env, Pad(1, MaterialField(young[env], 0.4)).press())
    np.testing.assert_array_equal(run.model.largest_moduli.numpy()[:, 0], [1e5, 3e5])


@pytest.mark.thorough
def test_a_mask_a_later_change_and_what_is_left_out() -> None:
    run = Pad(3)
    first = run.press()
    run.model.set_body("pad", poisson_ratio=0.3, mask=np.array([False, True, True]))
    wild = np.array([np.nan, np.nan, 2e5])
    run.model.set_body("pad", young_modulus_pa=wild, mask=np.array([False, False, True]))
    found = run.press()
    np.testing.assert_array_equal([value[0] for value in found], [value[0] for value in first])
    for env, material in ((1, Material(1e5, 0.3)), (2, Material(2e5, 0.3))):
        assert_same(found, env, Pad(1, material).press())


@pytest.mark.thorough
@pytest.mark.parametrize("capture", [False, True])
def test_captured_steps_notice(capture: bool) -> None:
    """Widened arrays move, and what is written later is read by the same graph."""
    ends = []
    for run in (Cubes(2, capture=capture), Cubes(2, capture=False)):
        run.shake(1, 4)
        run.model.set_body("pad", young_modulus_pa=[2e5, 5e4])
        run.model.set_body("cube", density_kg_m3=[500.0, 3000.0])
        run.shake(4, 7)
        assert (run.solver.graph.launches > 0) is (capture and not ends)
        run.model.set_body("pad", young_modulus_pa=[1e5, 8e4])
        run.model.set_friction("cube", "pad", [0.1, 0.9])
        ends.append(run.shake(7, 10))
    for value, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(value, other)


GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]


@pytest.mark.thorough(cases=("cpu",))
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda:0", marks=GPU)])
def test_a_loop_in_torch_is_that_of_built_models_on_every_device(device: str) -> None:
    model = pad_under_tool(3, GEL).finalize(device)
    solver = SolverIPC(model)
    where = wp.device_to_torch(model.device)
    young = torch.tensor(YOUNG, device=where)
    everyone = torch.ones(3, dtype=torch.bool, device=where)
    start, down, aside = (
        torch.from_numpy(everywhere(3, pose(x, 0, START_Z - z))).to(where)
        for x, z in ((0, 0), (0, 2.5e-4), (1e-4, 2.5e-4))
    )
    state = initial_state(model, start)
    for values in (young.flip(0), young, young):
        model.set_body("pad", young_modulus_pa=values, mask=everyone)
        model.set_friction("pad", "tool", values / 2e5, mask=everyone)
        solver.reset(state, everyone, start)
        for target in (down, aside):
            status = solver.step(state, Control(target)).on(device)["status"]
            assert (wp.to_torch(status) == 1).all()
    forces = solver.contact_gradient.numpy()[:, : model.soft_count].sum(axis=1)
    for env, value in enumerate(YOUNG):
        alone = Pad(1, Material(value, 0.4), friction=value / 2e5)
        alone.press()
        expected = -alone.force(0)
        assert np.abs(forces[env] - expected).max() < 2e-4 * np.abs(expected).max()


@pytest.mark.thorough
def test_a_contact_stiffness_of_the_solver_stays() -> None:
    run = Pad(2, kappa_pa=3e5)
    run.press()
    run.model.set_body("pad", young_modulus_pa=[5e4, 4e5])
    found = run.press()
    for env, young in enumerate((5e4, 4e5)):
        assert_same(found, env, Pad(1, Material(young, 0.4), kappa_pa=3e5).press())
