# SPDX-License-Identifier: Apache-2.0
"""Curved tets that are inside out somewhere, against a fine sampling of their volume ratio."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.elasticity.volume_bounds import (
    RATIO_SLACK,
    is_inside_out,
    least_coefficient,
    smallest_ratio,
)
from tests.support.turns import random_turns

COUNT = 400


@wp.kernel(enable_backward=False)
def _judge_kernel(
    f: wp.array2d(dtype=wp.mat33d),
    bounds: wp.array(dtype=wp.float64),
    judged: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    bounds[i] = least_coefficient(f[i, 0], f[i, 1], f[i, 2], f[i, 3])
    if is_inside_out(f[i, 0], f[i, 1], f[i, 2], f[i, 3]):
        judged[i] = 1


@wp.kernel(enable_backward=False)
def _ratio_kernel(
    f: wp.array2d(dtype=wp.mat33d), known: wp.float64, ratios: wp.array(dtype=wp.float64)
):
    i = wp.tid()
    ratios[i] = smallest_ratio(f[i, 0], f[i, 1], f[i, 2], f[i, 3], known)


def judge(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower bounds of J, and which tets [n, 4, 3, 3] are judged inside out."""
    count = len(corners)
    bounds, judged = wp.zeros(count, dtype=wp.float64), wp.zeros(count, dtype=wp.int32)
    f = wp.array(np.ascontiguousarray(corners), dtype=wp.mat33d)
    wp.launch(_judge_kernel, dim=count, inputs=[f], outputs=[bounds, judged])
    return bounds.numpy(), judged.numpy() != 0


def lattice(order: int) -> np.ndarray:
    """Barycentric coordinates of the points i / order, [n, 4]."""
    i, j, k = np.meshgrid(*3 * [np.arange(order + 1)], indexing="ij")
    inside = i + j + k <= order
    three = np.stack([i[inside], j[inside], k[inside]], axis=1)
    return np.column_stack([three, order - three.sum(axis=1)]) / order


def sampled(corners: np.ndarray, order: int = 24) -> np.ndarray:
    """Smallest J at the points of a fine lattice."""
    return np.array([np.linalg.det(np.tensordot(lattice(order), f, 1)).min() for f in corners])


def random_tets(spread: float) -> np.ndarray:
    rng = np.random.default_rng(int(100 * spread))
    return random_turns(rng, COUNT)[:, None] + spread * rng.normal(size=(COUNT, 4, 3, 3))


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.35, 0.6])
def test_judged_as_a_fine_sampling_says(spread: float) -> None:
    corners = random_tets(spread)
    bounds, judged = judge(corners)
    smallest = sampled(corners)
    assert (bounds <= smallest + 1e-12).all()
    # A sample proves inversion; without one J may still dip a little between the samples.
    assert judged[smallest <= 0].all()
    assert not judged[smallest > 0.02].any()


@pytest.mark.parametrize("spread", [0.2, 0.35, 0.6])
def test_smallest_ratio_is_that_of_a_fine_sampling(spread: float) -> None:
    """Not above any sample, and not below what the samples leave room for: J is smooth."""
    corners = random_tets(spread)
    f = wp.array(np.ascontiguousarray(corners), dtype=wp.mat33d)
    ratios = wp.zeros(COUNT, dtype=wp.float64)
    wp.launch(_ratio_kernel, dim=COUNT, inputs=[f, np.inf], outputs=[ratios])
    samples = sampled(corners)
    # Where J is steep or negative, ``MAX_BISECTIONS`` leaves a little more than the slack.
    assert (ratios.numpy() <= samples + 5 * float(RATIO_SLACK)).all()
    assert (ratios.numpy() >= samples - 0.01).all()
    # It lies inside the tet in some: neither corners nor middles of edges tell it.
    assert (ratios.numpy() < sampled(corners, 2) - 1e-3).any()
    # What is known to be less elsewhere stands.
    wp.launch(_ratio_kernel, dim=COUNT, inputs=[f, -9.0], outputs=[ratios])
    assert (ratios.numpy() == -9.0).all()


def edge_case(a: float, stretch: float = 1.0) -> np.ndarray:
    """Corner values with J = a > 0 at both ends of edge 01, whose J falls to -(1 - a)^2 / 4 between
    them when ``stretch`` is 1, nearer to one end when it is not."""
    first, second = np.diag([-1.0, -a, 1.0]), stretch * np.diag([a, 1.0, 1.0])
    return np.stack([first, second, np.eye(3), np.eye(3)])


@pytest.mark.parametrize("stretch", [1.0, 7.0, 0.2])
@pytest.mark.parametrize("a", [0.1, 0.6, 0.9])
def test_inside_out_between_the_ends_of_any_edge(a: float, stretch: float) -> None:
    corners = np.stack([edge_case(a, stretch)[list(order)] for order in permutations(range(4))])
    assert (np.linalg.det(corners) > 0).all()
    bounds, judged = judge(corners)
    assert judged.all()
    assert (bounds < 0).all()


@pytest.mark.parametrize("e", [0.3, 0.1, 0.03, 1e-6])
def test_a_narrow_pass_is_let_through(e: float) -> None:
    """J = x^2 + y^2 > 0 although x changes its sign: nothing is called inside out that is not."""
    first = np.array([[1.0, -e, 0], [e, 1.0, 0], [0, 0, 1.0]])
    second = np.array([[-1.0, -e, 0], [e, -1.0, 0], [0, 0, 1.0]])
    corners = np.stack([first, second, np.eye(3), np.eye(3)])
    assert sampled(corners[None], 40)[0] > 0
    orders = np.stack([corners[list(order)] for order in permutations(range(4))])
    assert not judge(orders)[1].any()
