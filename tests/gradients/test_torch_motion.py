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
from taccel_lab.gradients.torch_motion import MovedGels, TorchMotion
from taccel_lab.scene import Ball
from taccel_lab.signals import MarkerLayout
from taccel_lab.signals.torch_signals import height_map, marker_places
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


def tensors(**values: float) -> dict[str, torch.Tensor]:
    shapes = {"friction": (1,)}
    return {
        name: torch.full(shapes.get(name, (1, 1)), value, dtype=torch.float64, requires_grad=True)
        for name, value in values.items()
    }


def young_of(value: float) -> torch.Tensor:
    return tensors(young_modulus_pa=value)["young_modulus_pa"]


@pytest.mark.parametrize("loss", [of_markers, of_heights, of_forces])
def test_gradients_are_those_of_differences(loss: Callable[[MovedGels], torch.Tensor]) -> None:
    moving = TorchMotion(CASE.model(), TIGHT)
    inputs = tensors(young_modulus_pa=1.8e5, poisson_ratio=0.4, friction=0.35)
    poses = torch.tensor(CASE.poses, requires_grad=True)
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


def slope(poses: torch.Tensor, values: dict[str, float], name: str, step: float) -> float:
    moving = TorchMotion(CASE.model(), TIGHT)
    high, low = (
        float(of_forces(moving(poses, **tensors(**{**values, name: values[name] + by}))).detach())
        for by in (step, -step)
    )
    return (high - low) / (2 * step)


@pytest.mark.thorough
def test_two_calls_before_one_way_back() -> None:
    """Of other moduli, other friction and other numbers of steps, the model's own ones first."""
    moving = TorchMotion(CASE.model(), TIGHT)
    whole, short = torch.tensor(CASE.poses), torch.tensor(CASE.poses[:3])
    of_scene = whole.clone().requires_grad_()
    friction = tensors(friction=0.2)["friction"]
    soft, hard = young_of(1.2e5), young_of(3.1e5)
    total = of_forces(moving(of_scene)) + of_forces(moving(whole, young_modulus_pa=soft))
    total = total + of_forces(moving(short, young_modulus_pa=hard, friction=friction))
    after = moving.motion.model.pair_friction.numpy().copy()
    total.backward()
    np.testing.assert_array_equal(moving.motion.model.pair_friction.numpy(), after)
    alone = whole.clone().requires_grad_()
    of_forces(TorchMotion(CASE.model(), TIGHT)(alone)).backward()
    assert of_scene.grad is not None and alone.grad is not None
    np.testing.assert_allclose(of_scene.grad.numpy(), alone.grad.numpy(), rtol=1e-10, atol=1e-12)
    first = {"young_modulus_pa": 1.2e5}
    second = {"young_modulus_pa": 3.1e5, "friction": 0.2}
    for tensor, poses, values, name, step in (
        (soft, whole, first, "young_modulus_pa", 20.0),
        (hard, short, second, "young_modulus_pa", 20.0),
        (friction, short, second, "friction", 1e-5),
    ):
        assert tensor.grad is not None
        expected = slope(poses, values, name, step)
        assert float(tensor.grad) == pytest.approx(expected, rel=1e-5), values


@pytest.mark.thorough
def test_ways_back_in_any_order_and_again() -> None:
    moving, poses = TorchMotion(CASE.model(), TIGHT), torch.tensor(CASE.poses)
    soft, hard = young_of(1.2e5), young_of(3.1e5)
    first, second = (of_forces(moving(poses, young_modulus_pa=young)) for young in (soft, hard))
    slopes = {}
    for turn, (loss, young) in enumerate([(first, soft), (second, hard)] * 2):
        (slopes[turn],) = torch.autograd.grad(loss, young, retain_graph=True)
    assert slopes[0] == slopes[2] and slopes[1] == slopes[3]
    for turn, value in ((0, 1.2e5), (1, 3.1e5)):
        expected = slope(poses, {"young_modulus_pa": value}, "young_modulus_pa", 20.0)
        assert float(slopes[turn]) == pytest.approx(expected, rel=1e-5)
    # A call between a motion and its way back leaves what later calls find.
    as_it_is = of_forces(moving(poses))
    assert float(as_it_is) == pytest.approx(float(second.detach()), rel=1e-10)


def test_jacobians_by_torch_func() -> None:
    moving, poses = TorchMotion(CASE.model(), TIGHT), torch.tensor(CASE.poses)

    def forces(young: torch.Tensor) -> torch.Tensor:
        return moving(poses, young_modulus_pa=young).wrenches[-1, 0, 0, :3]

    at = young_of(1.8e5).detach()
    one_by_one = torch.autograd.functional.jacobian(forces, at)
    found = torch.func.jacrev(forces)(at)
    np.testing.assert_allclose(found.numpy(), one_by_one.numpy(), rtol=1e-12)
    step = 20.0
    expected = (forces(at + step) - forces(at - step)) / (2 * step)
    np.testing.assert_allclose(one_by_one.flatten().numpy(), expected.numpy(), rtol=1e-5)


def test_second_derivatives_are_refused() -> None:
    moving, young = TorchMotion(CASE.model(), TIGHT), young_of(1.8e5)
    loss = of_forces(moving(torch.tensor(CASE.poses), young_modulus_pa=young))
    (once,) = torch.autograd.grad(loss, young, create_graph=True)
    with pytest.raises(InputError, match="first derivatives only"):
        torch.autograd.grad(once.sum(), young)


@pytest.mark.parametrize("name", ["poses", "young_modulus_pa", "poisson_ratio", "friction"])
def test_what_is_no_tensor_is_named(name: str) -> None:
    given = {"poses": torch.tensor(CASE.poses), name: np.array([[0.4]])}
    with pytest.raises(InputError, match=f"^{name} must be a torch tensor, got ndarray"):
        TorchMotion(CASE.model(), TIGHT)(**given)  # type: ignore[arg-type]
    for read in (
        lambda: marker_places(MESH.nodes_m[None], MARKERS),  # type: ignore[arg-type]
        lambda: height_map(MESH.nodes_m[None], FACES, GRID),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError, match=r"^positions must be a torch tensor, got ndarray"):
            read()


def test_where_the_motion_is_given_markers_do_not_know_the_modulus() -> None:
    """The stiffness of the contact follows it, so that all forces scale and nothing else moves."""
    moving = TorchMotion(CASE.model(), TIGHT)
    given = tensors(young_modulus_pa=1.8e5, friction=0.35)
    young, moved = given["young_modulus_pa"], moving(torch.tensor(CASE.poses), **given)
    by_young, by_friction = torch.autograd.grad(
        of_markers(moved), tuple(given.values()), retain_graph=True
    )
    assert abs(float(1.8e5 * by_young)) < 1e-7 * abs(float(0.35 * by_friction))
    (of_force,) = torch.autograd.grad(moved.wrenches[-1, 0, 0, 2], young)
    force = float(moved.wrenches[-1, 0, 0, 2].detach())
    assert float(1.8e5 * of_force) == pytest.approx(force, rel=1e-7)
