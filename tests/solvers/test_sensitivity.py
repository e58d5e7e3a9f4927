# SPDX-License-Identifier: Apache-2.0
"""Slopes of the force on a tool by the implicit function theorem, against finite differences of
presses that were solved anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, parse_indenter
from taccel_lab.scene import Element, Material, MaterialField, MaterialModel
from taccel_lab.solvers import SolverConfig
from taccel_lab.solvers.sensitivity import elastic_power, groups_of, node_rates

MESH = block_mesh((5, 5, 2), (10e-3, 10e-3, 3e-3))
# The contact stiffness follows Young's modulus unless it is said.
TIGHT = SolverConfig(relative_tolerance=1e-10, absolute_tolerance_n=1e-10, kappa_pa=1e6)
DOWN = np.array([[[0.0, 0.0, -1.0]]])
MOONEY = Material(3e5, 0.47, model=MaterialModel.MOONEY_RIVLIN, mooney_ratio=0.4)


@pytest.fixture(autouse=True)
def held_back_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes are those of the force at one place of the tool: no correction for the gap, which
    comes in steps of its tolerance."""
    monkeypatch.setattr("taccel_lab.presses.press.SETBACK_TOLERANCE", 1e9)


def press(
    material: Material | MaterialField,
    depth_mm: float | Sequence[float] = 0.6,
    element: Element = Element.QUADRATIC,
    indenter: str = "sphere:6",
    config: SolverConfig = TIGHT,
    at_mm: tuple[float, float] = (0.0, 0.0),
) -> PressEnv:
    depths = np.atleast_1d(depth_mm)
    env = PressEnv(
        MESH, material, parse_indenter(indenter), np.tile(at_mm, (len(depths), 1)),
        physics=replace(PHYSICS[Accuracy.DEFAULT], element=element), config=config,
    )  # fmt: skip
    env.move_to(depths)
    return env


def slopes(env: PressEnv, before: Material, after: Material, difference: float) -> np.ndarray:
    down = np.tile(DOWN, (len(env.at_m), 1, 1))
    rates = node_rates(env.solver, env.state, down)
    work = [
        elastic_power(env.solver, env.state, rates, groups_of(env.model.elastic, [material]))
        for material in (before, after)
    ]
    return (work[1] - work[0]) / difference


@pytest.mark.parametrize("element", list(Element))
@pytest.mark.parametrize(
    ("name", "step"), [("young_modulus_pa", 3e2), ("poisson_ratio", 5e-5), ("mooney_ratio", 1e-3)]
)
def test_slopes_over_the_parameters_of_a_law(element: Element, name: str, step: float) -> None:
    sides = [replace(MOONEY, **{name: getattr(MOONEY, name) + s * step}) for s in (-1, 1)]
    found = slopes(press(MOONEY, element=element), sides[0], sides[1], 2 * step)[0]
    lower, upper = (press(side, element=element).press_force[0, 2] for side in sides)
    assert found == pytest.approx((upper - lower) / (2 * step), rel=2e-4)
    assert abs(found * getattr(MOONEY, name)) > 0.01


@pytest.mark.parametrize("indenter", ["cylinder:2", "box:4x3"])
def test_tools_of_triangles(indenter: str) -> None:
    gel = Material(3e5, 0.45)
    sides = [replace(gel, poisson_ratio=0.45 + s * 1e-4) for s in (-1, 1)]

    def pressed(material: Material) -> PressEnv:
        # In the middle nodes lie on edges of the tool's triangles, where rounding, which processors
        # do not share, says what is nearest: forces then differ by 1e-5, as much as a side does.
        return press(material, 0.4, indenter=indenter, at_mm=(0.0013, 0.0007))

    found = slopes(pressed(gel), sides[0], sides[1], 2e-4)[0]
    lower, upper = (pressed(side).press_force[0, 2] for side in sides)
    assert found == pytest.approx((upper - lower) / 2e-4, rel=1e-4)


def test_each_environment_has_its_own_slope() -> None:
    gel = Material(3e5, 0.45)
    sides = [replace(gel, poisson_ratio=0.45 + s * 1e-4) for s in (-1, 1)]
    depths = (0.2, 0.5, 0.7)
    together = slopes(press(gel, depths), sides[0], sides[1], 2e-4)
    for depth, found in zip(depths, together, strict=True):
        alone = slopes(press(gel, depth), sides[0], sides[1], 2e-4)[0]
        assert found == pytest.approx(alone, rel=1e-5)


def test_nodes_go_along_with_the_tool() -> None:
    gel = Material(3e5, 0.45)
    env = press(gel, 0.5)
    before = env.positions[0].copy()
    rates = node_rates(env.solver, env.state, DOWN).rates.numpy()[0, : env.model.soft_count]
    np.testing.assert_array_equal(env.positions[0], before)
    # The power of the elastic forces is that of the tool's: at equilibrium F = g . u_s + Pi_s,
    # where Pi_s is the whole force and g . u_s what the contact leaves of it for the gel.
    env.move_to(0.5 + 1e-4)
    ahead = env.positions[0].copy()
    env.move_to(0.5 - 1e-4)
    difference = (ahead - env.positions[0]) / 2e-7
    np.testing.assert_allclose(rates, difference, atol=2e-3 * np.abs(rates).max())
    assert np.abs(rates).max() > 0.9
    power = elastic_power(env.solver, env.state, node_rates(env.solver, env.state, DOWN))[0]
    assert power == pytest.approx(env.press_force[0, 2], rel=2e-2)


def test_the_solver_steps_on_as_if_nothing_had_been_asked() -> None:
    gel = Material(3e5, 0.45)
    asked, plain = press(gel, 0.3), press(gel, 0.3)
    slopes(asked, gel, replace(gel, poisson_ratio=0.46), 0.01)
    for env in (asked, plain):
        env.move_to(0.6)
    np.testing.assert_array_equal(asked.positions, plain.positions)
    np.testing.assert_array_equal(asked.press_force, plain.press_force)


def test_what_has_no_slopes_is_refused() -> None:
    gel = Material(3e5, 0.45)
    rubbing = PressEnv(
        MESH, gel, parse_indenter("sphere:6"), np.zeros((1, 2)), friction_coefficient=0.3
    )
    with pytest.raises(InputError, match="without friction"):
        node_rates(rubbing.solver, rubbing.state, DOWN)
    hasty = press(gel, 0.5)
    hasty.solver.config = replace(hasty.solver.config, max_cg_iterations=2)
    rates = node_rates(hasty.solver, hasty.state, DOWN)
    assert not rates.solved[0]
    assert np.isnan(elastic_power(hasty.solver, hasty.state, rates)[0])
