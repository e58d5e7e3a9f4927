# SPDX-License-Identifier: Apache-2.0
"""Curved tets that are inside out somewhere, against a fine sampling of their volume ratio."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from taccel_lab.ipc.elasticity.volume_bounds import (
    RATIO_SLACK,
    is_inside_out,
    least_coefficient,
    smallest_ratio,
)
from tests.ipc.batch import mapped
from tests.support.turns import random_turns

COUNT = 400


def judge(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    f = corners.swapaxes(0, 1)
    return mapped(least_coefficient, *f), mapped(is_inside_out, *f) != 0


def sampled(corners: np.ndarray, order: int = 24) -> np.ndarray:
    points = np.indices((order + 1,) * 3).reshape(3, -1).T
    points = points[points.sum(axis=1) <= order]
    lattice = np.column_stack([points, order - points.sum(axis=1)]) / order
    return np.array([np.linalg.det(np.tensordot(lattice, f, 1)).min() for f in corners])


@pytest.mark.parametrize("spread", [0.05, 0.2, 0.35, 0.6])
def test_judged_and_bounded_as_a_fine_sampling_says(spread: float) -> None:
    rng = np.random.default_rng(int(100 * spread))
    corners = random_turns(rng, COUNT)[:, None] + spread * rng.normal(size=(COUNT, 4, 3, 3))
    bounds, judged = judge(corners)
    samples = sampled(corners)
    assert (bounds <= samples + 1e-12).all()
    # A sample proves inversion; without one J may still dip a little between the samples.
    assert judged[samples <= 0].all() and not judged[samples > 0.02].any()
    # The smallest ratio is not below what the samples leave room for, since J is smooth. Where J is
    # steep or negative, ``MAX_BISECTIONS`` leaves a little more than the slack.
    ratios = mapped(smallest_ratio, *corners.swapaxes(0, 1), np.inf)
    if spread > 0.1:
        assert (ratios <= samples + 5 * float(RATIO_SLACK)).all()
        assert (ratios >= samples - 0.01).all()
        # It lies inside the tet in some: neither corners nor middles of edges tell it.
        assert (ratios < sampled(corners, 2) - 1e-3).any()
    # What is known to be less elsewhere stands.
    assert (mapped(smallest_ratio, *corners.swapaxes(0, 1), -9.0) == -9.0).all()


def in_any_order(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Tets with these F at the ends of any edge, and none elsewhere, [24, 4, 3, 3]."""
    corners = np.stack([first, second, np.eye(3), np.eye(3)])
    return np.stack([corners[list(order)] for order in permutations(range(4))])


@pytest.mark.parametrize("stretch", [1.0, 7.0, 0.2])
@pytest.mark.parametrize("a", [0.1, 0.6, 0.9])
def test_inside_out_between_the_ends_of_any_edge(a: float, stretch: float) -> None:
    """J = a > 0 at both ends falls to -(1 - a)^2 / 4 between them when ``stretch`` is 1."""
    corners = in_any_order(np.diag([-1.0, -a, 1.0]), stretch * np.diag([a, 1.0, 1.0]))
    assert (np.linalg.det(corners) > 0).all()
    bounds, judged = judge(corners)
    assert judged.all() and (bounds < 0).all()


@pytest.mark.parametrize("e", [0.3, 0.1, 0.03, 1e-6])
def test_a_narrow_pass_is_let_through(e: float) -> None:
    """J = x^2 + y^2 > 0 although x changes its sign: nothing is called inside out that is not."""
    first = np.array([[1.0, -e, 0], [e, 1.0, 0], [0, 0, 1.0]])
    corners = in_any_order(first, np.array([[-1.0, -e, 0], [e, -1.0, 0], [0, 0, 1.0]]))
    assert sampled(corners[:1], 40)[0] > 0 and not judge(corners)[1].any()
