# SPDX-License-Identifier: Apache-2.0
"""Where there is no slope it says so, in that environment alone; what has none is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.gradients import GelMotion, Gradients, pull_back
from taccel_lab.scene import Ball, KinematicBody, Material, MaterialField, Scene, SoftBody
from tests.gradients.gel_scenes import GEL, MESH, TIGHT, Case, losses, pose, press_and_shear
from tests.support.scene_steps import in_time

PRESS = press_and_shear(3.0, 0.3)


def given(gradients: Gradients, env: int) -> np.ndarray:
    parts = (gradients.young_modulus, gradients.poisson_ratio, gradients.scale, gradients.friction)
    return np.concatenate([part[env].ravel() for part in parts] + [gradients.poses[:, env].ravel()])


def test_an_environment_that_fails_leaves_the_others_their_slopes() -> None:
    through = PRESS.copy()
    through[2:, 2] -= 4e-3  # Through the gel's bond.
    poses = np.stack([PRESS, through], axis=1)[:, :, None]
    case = Case(Ball(3e-3), poses, 0.3, config=replace(TIGHT, max_newton_iterations=60))
    motion = GelMotion(case.model(), case.config)
    record = motion.run(poses)
    assert record.causes[0] is None
    assert record.causes[1] is not None
    assert record.causes[1].startswith("step 2 did not converge undivided")
    assert np.isfinite(record.positions[:, 0]).all()
    assert np.isfinite(record.positions[0]).all() and np.isnan(record.positions[1:, 1]).all()
    weights = [np.nan_to_num(part) for part in losses(record)]
    found = pull_back(motion, record, *weights)
    assert found.causes == record.causes
    assert np.isfinite(given(found, 0)).all() and np.isnan(given(found, 1)).all()
    alone = replace(case, poses=poses[:, :1])
    other, its_record = alone.run()
    expected = pull_back(other, its_record, weights[0][:, :1], weights[1][:, :1])
    np.testing.assert_allclose(given(found, 0), given(expected, 0), rtol=1e-8)


def test_a_step_that_began_over_a_border_has_two_slopes() -> None:
    """Nodes of two gels on grids that meet: one is right over the diagonal of a face."""
    down = np.stack([pose((0, 0, z), (180, 0, 0)) for z in (0.1, -0.1)])
    case = Case(None, down[:, None, None], 0.4, carried=Material(4e5, 0.4))
    motion, record = case.run()
    found = pull_back(motion, record, *losses(record))
    assert found.causes[0] is not None and "right over the border" in found.causes[0]
    assert np.isnan(given(found, 0)).all()


def test_an_end_that_is_no_stable_equilibrium_has_no_slope() -> None:
    for friction in (0.0, 0.3):
        case = Case(Ball(3e-3), PRESS[:, None, None], friction)
        motion, record = case.run()
        gel = motion.model.bodies[0].node_slice
        squeezed = record.positions.copy()
        squeezed[-1, :, gel] = MESH.nodes_m * [1, 1, 0.45] - [0, 0, 1.65e-3 + 1e-5]
        found = pull_back(motion, replace(record, positions=squeezed), *losses(record))
        assert found.causes[0] is not None and found.causes[0].startswith("step 3: the "), friction
        assert np.isnan(given(found, 0)).all()


@pytest.mark.thorough
def test_moduli_that_tie_for_the_contact_have_no_slope_alone() -> None:
    """The contact stiffness is the larger modulus: at equal ones it has a kink, and they alone."""
    shifted = PRESS + [1.3e-5, 1.7e-5, -3e-3, 0, 0, 0, 0]
    turned = np.stack([pose(tuple(1e3 * row[:3]), (180, 0, 0)) for row in shifted])
    case = Case(None, turned[:, None, None], 0.4, carried=GEL)
    motion, record = case.run()
    found = pull_back(motion, record, *losses(record))
    assert found.causes == [None]
    assert np.isnan(found.young_modulus).all()
    assert np.isfinite(found.poisson_ratio).all() and np.isfinite(found.poses).all()
    fixed = replace(case, config=replace(TIGHT, kappa_pa=3e5))
    motion, record = fixed.run()
    assert np.isfinite(pull_back(motion, record, *losses(record)).young_modulus).all()


def test_what_is_not_supported_is_named() -> None:
    gel, ball = SoftBody(MESH, GEL), KinematicBody(Ball(3e-3))
    field = MaterialField(np.full(MESH.tet_count, 2e5), np.full(MESH.tet_count, 0.4))
    for scene, match in (
        (Scene(gel, ball, time=in_time(1e-2, 0.0)), "affine bodies, joints and inertia"),
        (Scene(replace(gel, material=field), ball), "'gel' varies by tet"),
    ):
        with pytest.raises(InputError, match=match):
            GelMotion(scene.finalize("cpu"))
    motion = GelMotion(Scene(gel, ball).finalize("cpu"))
    motion.model.set_body("gel", young_modulus_pa=np.linspace(1e5, 2e5, MESH.tet_count)[None])
    record = motion.run(PRESS[:, None, None])
    with pytest.raises(InputError, match="'gel' was set by tet"):
        pull_back(motion, record)


def test_bad_arrays_are_refused() -> None:
    case = Case(Ball(3e-3), PRESS[:, None, None])
    motion, record = case.run()
    with pytest.raises(InputError, match="dL/d positions must have shape"):
        pull_back(motion, record, positions=np.zeros(3))
    with pytest.raises(InputError, match="at least one step"):
        motion.run(case.poses[:1])
    assert np.isnan(pull_back(motion, record).friction).all()


def test_parameters_of_a_record_are_its_own() -> None:
    """What is set after a motion, even by tet, is not in its gradients, and is there after them."""
    for friction in (0.0, 0.3):
        case = Case(Ball(3e-3), PRESS[:, None, None], friction)
        motion, record = case.run()
        weights = losses(record)
        expected = given(pull_back(motion, record, *weights), 0)
        later = np.linspace(1e5, 3e5, MESH.tet_count)[None]
        motion.model.set_body("gel", young_modulus_pa=later, poisson_ratio=0.3)
        if friction:
            motion.model.set_friction("gel", "tool", 0.7)
        found = given(pull_back(motion, record, *weights), 0)
        np.testing.assert_array_equal(found, expected)
        again = motion.run(case.poses)
        assert np.abs(again.wrenches - record.wrenches).max() > 1e-3
        young = motion.model.elastic[0].young_moduli
        assert young is not None
        np.testing.assert_array_equal(young.numpy(), later[0])
