# SPDX-License-Identifier: Apache-2.0
"""Losses of torch go back through a motion: markers, heights, forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.gradients.torch_motion import MovedGels, TorchMotion, height_map, marker_places
from taccel_lab.scene import Ball
from taccel_lab.signals import MarkerLayout
from tests.gradients.gel_scenes import MESH, TIGHT, Case, press_and_shear

CASE = Case(Ball(3e-3), press_and_shear(3.0, 0.3)[:, None, None], friction=0.3)
GRID = PixelGrid(23, 19, 0.21, 0.21)
FACES = MESH.region_faces(Region.CONTACT)
MARKERS = MarkerLayout.from_points(
    MESH, np.stack(np.meshgrid(np.arange(-2.0, 3.0), np.arange(-2.0, 3.0)), axis=-1).reshape(-1, 2)
)


def of_markers(moved: MovedGels) -> torch.Tensor:
    places = marker_places(moved.positions, MARKERS)
    return (1e3 * places[..., :2]).square().sum()


def of_heights(moved: MovedGels) -> torch.Tensor:
    heights = 1e3 * height_map(moved.positions[-1], FACES, GRID)
    seen = ~torch.isnan(heights)
    assert 0 < seen.sum() <= heights.numel()
    return heights[seen].square().sum()


def of_forces(moved: MovedGels) -> torch.Tensor:
    return moved.wrenches[..., :3].square().sum()


@pytest.mark.parametrize("loss", [of_markers, of_heights, of_forces])
def test_gradients_are_those_of_differences(loss: Callable[[MovedGels], torch.Tensor]) -> None:
    moving = TorchMotion(CASE.model(), TIGHT)
    values = {
        "young_modulus_pa": torch.full((1, 1), 1.8e5, dtype=torch.float64),
        "poisson_ratio": torch.full((1, 1), 0.4, dtype=torch.float64),
        "friction": torch.full((1,), 0.35, dtype=torch.float64),
    }
    poses = torch.tensor(CASE.poses, requires_grad=True)
    inputs = {name: value.requires_grad_() for name, value in values.items()}
    loss(moving(poses, **inputs)).backward()
    down = torch.zeros_like(poses)
    down[-1, ..., 2] = 1.0

    def at(name: str, by: float) -> float:
        shifted = {key: v.detach() + (by if key == name else 0.0) for key, v in inputs.items()}
        way = down * by if name == "poses" else 0.0
        return float(loss(moving(poses.detach() + way, **shifted)))

    sizes = {"young_modulus_pa": 20.0, "poisson_ratio": 1e-5, "friction": 1e-5, "poses": 1e-8}
    for name, step in sizes.items():
        expected = (at(name, step) - at(name, -step)) / (2 * step)
        grad = (poses.grad * down).sum() if name == "poses" else inputs[name].grad  # type: ignore[operator]
        assert grad is not None
        assert float(grad.sum()) == pytest.approx(expected, rel=1e-5), name


def test_heights_are_those_of_the_mesh() -> None:
    """A face that is tilted has the height of its plane everywhere, and none beside it."""
    tilted = MESH.nodes_m.copy()
    tilted[:, 2] += 0.02 * tilted[:, 0] - 0.01 * tilted[:, 1]
    wide = PixelGrid(60, 40, 0.21, 0.21)
    found = height_map(torch.tensor(tilted[None]), FACES, wide)[0].numpy()
    x, y = np.meshgrid(wide.x_mm() * 1e-3, wide.y_mm() * 1e-3)
    inside = np.maximum(np.abs(x), np.abs(y)) < 4e-3
    np.testing.assert_array_equal(np.isnan(found), ~inside)
    np.testing.assert_allclose(found[inside], (0.02 * x - 0.01 * y)[inside], atol=1e-15)


def test_a_failed_environment_says_why() -> None:
    deep = CASE.poses.copy()
    deep[1:, ..., 2] -= 2.6e-3
    hasty = replace(TIGHT, max_newton_iterations=3)
    moved = TorchMotion(CASE.model(), hasty)(torch.tensor(deep))
    assert moved.causes[0] is not None and "did not converge" in moved.causes[0]
    assert torch.isnan(moved.positions).all()


def test_bad_shapes_are_refused() -> None:
    moving = TorchMotion(CASE.model(), TIGHT)
    with pytest.raises(InputError, match=r"young_modulus_pa must have shape \[1, 1\]"):
        moving(torch.tensor(CASE.poses), young_modulus_pa=torch.tensor([2e5]))


def test_parameters_of_a_later_call_do_not_pass_for_those_of_an_earlier_one() -> None:
    moving = TorchMotion(CASE.model(), TIGHT)
    young = torch.full((1, 1), 1.8e5, dtype=torch.float64, requires_grad=True)
    first = of_forces(moving(torch.tensor(CASE.poses), young_modulus_pa=young))
    of_forces(moving(torch.tensor(CASE.poses), young_modulus_pa=1.1 * young)).backward()
    with pytest.raises(InputError, match="set anew since"):
        first.backward()


def test_where_the_motion_is_given_markers_do_not_know_the_modulus() -> None:
    """The stiffness of the contact follows it, so that all forces scale and nothing else moves."""
    moving = TorchMotion(CASE.model(), TIGHT)
    young = torch.full((1, 1), 1.8e5, dtype=torch.float64, requires_grad=True)
    friction = torch.full((1,), 0.35, dtype=torch.float64, requires_grad=True)
    moved = moving(torch.tensor(CASE.poses), young_modulus_pa=young, friction=friction)
    by_young, by_friction = torch.autograd.grad(
        of_markers(moved), (young, friction), retain_graph=True
    )
    assert abs(float(1.8e5 * by_young)) < 1e-7 * abs(float(0.35 * by_friction))
    (of_force,) = torch.autograd.grad(moved.wrenches[-1, 0, 0, 2], young)
    force = float(moved.wrenches[-1, 0, 0, 2].detach())
    assert float(1.8e5 * of_force) == pytest.approx(force, rel=1e-7)
