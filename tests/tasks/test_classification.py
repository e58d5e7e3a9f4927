# SPDX-License-Identifier: Apache-2.0
"""Parts, what is learned from their depth maps, and one grasp of each of two parts."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.bodies.mesh_checks import check_tets
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.tasks.catalogue import named
from taccel_lab.tasks.classification import (
    Classification,
    Learner,
    alike,
    folds,
    judge_by_folds,
    nearest,
)
from taccel_lab.tasks.parts import PARTS, SEGMENTS
from taccel_lab.tasks.result import TaskTrial
from tests.tasks.changed import parameters

ROUND = SEGMENTS / (2 * np.pi) * np.sin(2 * np.pi / SEGMENTS)
"""Area of what stands for a disc, of the disc's."""
VOLUMES_MM3 = {
    "hex nut": 13**2 * np.sqrt(3) / 2 * 6.5 - ROUND * np.pi * 3.4**2 * 6.5,
    "washer": ROUND * np.pi * (8.0**2 - 4.2**2) * 1.6,
    "hex bolt": 13**2 * np.sqrt(3) / 2 * 5.3 + ROUND * np.pi * 4**2 * 14,
    "bushing": ROUND * np.pi * ((8**2 - 4**2) * 2 + (5.5**2 - 4**2) * 8),
    "bracket": (12 * 12 - 9 * 9) * 14,
}


@pytest.mark.parametrize("name", PARTS)
def test_parts_are_closed_and_as_large_as_drawn(name: str) -> None:
    shape = PARTS[name]()
    volume = 1e9 * mass_properties(shape, 1000.0).volume_m3
    assert volume == pytest.approx(VOLUMES_MM3.get(name, volume), rel=1e-3)
    high, low = shape.vertices_m.max(axis=0), shape.vertices_m.min(axis=0)
    np.testing.assert_allclose(high, -low, atol=1e-12)
    assert 4e-3 < (high - low).max() < 25e-3


def test_half_turns_of_the_hand_are_undone_by_themselves() -> None:
    maps = np.random.default_rng(1).random((3, 2, 4, 6))
    for k, once in enumerate(alike(maps)):
        np.testing.assert_array_equal(alike(once)[k], maps)


def blobs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Grasps of a short and of a long thing, anywhere, and which of them."""
    random = np.random.default_rng(5)
    y, x = np.mgrid[:16, :12]
    truth = np.arange(count) % 2
    maps = np.empty((count, 2, 16, 12))
    for i, long in enumerate(truth):
        u, v = x - random.uniform(4, 8), y - random.uniform(6, 10)
        maps[i] = 1e-3 * np.exp(-(u**2) / 3 - v**2 / (12 if long else 3))
    return maps, truth


@pytest.mark.thorough
def test_a_network_tells_grasps_that_it_has_not_seen() -> None:
    maps, truth = blobs(64)
    fold = folds(len(truth), 4)
    assert sorted(np.bincount(fold)) == [16] * 4
    learner = Learner(regions=4, epochs=15, batch=16, learning_rate=0.005)
    told = judge_by_folds(maps, truth, fold, learner)
    assert (told == truth).mean() > 0.9
    np.testing.assert_array_equal(told, judge_by_folds(maps, truth, fold, learner))
    # Labels that mean nothing cannot be told.
    random = np.random.default_rng(2).permutation(truth)
    assert (judge_by_folds(maps, random, fold, learner) == random).mean() < 0.75


def test_the_nearest_grasp_is_looked_for_in_other_folds() -> None:
    maps, truth = blobs(6)
    maps = np.concatenate([maps, maps[:, ::-1, ::-1, ::-1]])
    truth = np.concatenate([truth, truth])
    # Each grasp has its double, turned about, in the other fold, and itself in its own.
    np.testing.assert_array_equal(nearest(maps, truth, np.arange(12) // 6), truth)


@pytest.mark.thorough
def test_each_gel_closes_until_its_own_map_is_deep_enough() -> None:
    task = named("object-classification")
    episode = task.begin([1, 3], "cpu")
    assert isinstance(episode, Classification)
    assert not episode.depths_m.any()
    while not episode.over:
        episode.advance()
    maps = parameters("object-classification").maps
    size = (2, 2, maps.height_px, maps.width_px)
    assert episode.depths_m.shape == size
    for env, trial in enumerate(episode.trials()):
        assert trial.success and trial.felt is not None
        for depth in (trial.figures["left_depth_mm"], trial.figures["right_depth_mm"]):
            assert trial.start["depth_mm"] <= depth <= trial.start["depth_mm"] + 0.25
        np.testing.assert_array_equal(trial.felt, episode.depths_m[env].astype(np.float32))
    assert min(episode.forces().values()) > 0.05


def test_too_few_grasps_are_no_lesson() -> None:
    start = {"part": 0.0, "turn_deg": 10.0}
    lost = TaskTrial(1, False, "solver: OVERLAP in step 1", 0, start, {}, np.zeros((2, 40, 32)))
    good = TaskTrial(0, True, "", 5, start, {}, np.zeros((2, 40, 32)))
    found = Classification.conclude(parameters("object-classification"), [good, lost], "cpu")
    assert not found[0].success and "too few grasps" in found[0].cause
    assert found[1].cause == lost.cause


BEAR = (
    (0.0, 0.0, 14.0, 13.0),  # Belly.
    (0.0, -1.0, 32.0, 10.0),  # Head.
    (0.0, -10.0, 30.0, 4.5),  # Snout.
    (8.0, 1.0, 39.5, 4.0), (-8.0, 1.0, 39.5, 4.0),  # Ears.
    (12.0, -5.0, 19.0, 4.5), (-12.0, -5.0, 19.0, 4.5),  # Arms.
    (8.5, -9.0, 5.5, 5.5), (-8.5, -9.0, 5.5, 5.5),  # Legs.
    (0.0, 11.0, 5.0, 5.0),  # Tail, on which it sits.
)  # fmt: skip
"""Middle and radius of each ball [mm]; it sits on z = 0 and looks along -y."""


def test_the_bear_is_the_union_of_its_balls() -> None:
    bear = parameters("soft-bear").object
    mesh = bear.shape()
    check_tets(mesh, "bear")
    np.testing.assert_allclose(mesh.nodes_m.mean(axis=0), 0, atol=1e-12)
    balls = np.array(BEAR)
    points = np.random.default_rng(0).uniform([-20, -20, -2], [20, 20, 46], (200_000, 3))
    away = np.linalg.norm(points[:, None] - balls[:, :3], axis=2) - balls[:, 3]
    volume = 40 * 40 * 48 * (away.min(axis=1) < 0).mean()
    assert 1e9 * tet_volumes(mesh.nodes_m, mesh.tets).sum() == pytest.approx(volume, rel=0.1)
    assert bear.half_height_m == pytest.approx(19e-3, abs=2e-3)
