# SPDX-License-Identifier: Apache-2.0
"""How far a step may go when ridges meet: edge pairs alone limit it, never late, hardly early.

Two tets lie with an edge of each, their ridges, next to one another; all other nodes are far off.
Where the ridges cross inside of both, they touch when the gap along their common normal is gone.
"""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.contact.step_limit import limit_checks
from taccel_lab.scene import Element, Material, Scene, SoftBody, Surface, TimeStepping
from tests.ipc.batch import unit
from tests.support.blocks import pose
from tests.support.turns import random_turns

HALF_M, DEEP_M = 1e-3, 2e-3
SLACKNESS = 0.1
TETS = np.array([[0, 1, 2, 3]])
FACES = boundary_faces(TETS)
NODES_M = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 2], [0, -1, 2]]) * HALF_M
RIDGES = [0, 1, 4, 5]


def limits(
    x: np.ndarray, dx: np.ndarray, thickness_m: float = 0.0, most: float = 1.0
) -> np.ndarray:
    bodies = [
        SoftBody(
            TetMesh(NODES_M, TETS, FACES, np.zeros(len(FACES), dtype=np.int64)),
            Material(1e5, 0.4),
            bonded_nodes=np.zeros(0, dtype=np.int64),
            name=name,
            element=Element.LINEAR,
            surface=Surface(thickness_m=thickness_m),
            initial_pose=pose(0, 0, z),
        )
        for name, z in (("upper", 1.0), ("lower", -1.0))
    ]
    time, count = TimeStepping(quasi_static=False), len(x)
    model = Scene(bodies, env_count=count, time=time).finalize()
    flags, found = wp.full(count, 1, dtype=wp.int32), wp.full(count, most, dtype=wp.float64)
    positions, way = wp.array(x, dtype=wp.vec3d), wp.array(dx, dtype=wp.vec3d)
    poses = wp.zeros((count, 0), dtype=wp.transformd)
    # A tenth of the largest gap here: what keeps more is no candidate.
    candidates = Candidates(model)
    candidates.update(flags, positions, way, poses, poses, 1e-5)
    for check in limit_checks(model, flags, candidates, positions, way, found, SLACKNESS):
        check()
    return found.numpy()


class Ridges:
    """Ridges that cross anywhere in their inner four fifths, in any direction of space."""

    def __init__(
        self,
        rng: np.random.Generator,
        angle_rad: np.ndarray,
        gap_m: np.ndarray,
        halves_m: tuple[float, float] = (HALF_M, HALF_M),
    ) -> None:
        count, zero = len(angle_rad), 0 * angle_rad
        first = np.stack([zero + 1, zero, zero], axis=1)
        second = np.stack([np.cos(angle_rad), np.sin(angle_rad), zero], axis=1)
        up, x = np.array([0.0, 0.0, 1.0]), np.zeros((count, 8, 3))
        for start, ridge, half, side in ((0, first, halves_m[0], 1), (4, second, halves_m[1], -1)):
            middle = rng.uniform(-0.8, 0.8, (count, 1)) * half * ridge
            across = side * HALF_M * np.cross(up, ridge)
            ends = (-half * ridge, half * ridge)
            behind = (across + side * DEEP_M * up, -across + side * DEEP_M * up)
            for k, way in enumerate((*ends, *behind)):
                x[:, start + k] = middle + way
        x[:, :4] += gap_m[:, None, None] * up
        turned = random_turns(rng, count)
        self.rng = rng
        self.x = np.einsum("eij,enj->eni", turned, x)
        """[env, 8, 3] [m]."""
        self.normal, self.along = turned[:, :, 2], turned[:, :, 0]
        """From the lower ridge to the upper one, and direction of that, [env, 3]."""

    def closing(self, closing_m: np.ndarray, slide_m: np.ndarray | float = 0.0) -> np.ndarray:
        """Both bodies move, each by a part, with a drift; they slide along the upper ridge."""
        count = len(closing_m)
        slide_m = np.broadcast_to(slide_m, count)
        relative = -closing_m[:, None] * self.normal + slide_m[:, None] * self.along
        part = self.rng.uniform(0, 1, (count, 1))
        drift = 1e-3 * unit(self.rng.normal(size=(count, 3)))
        both = (drift + part * relative, drift - (1 - part) * relative)
        return np.repeat(np.stack(both, axis=1), 4, axis=1)


@pytest.mark.parametrize(
    ("angles_rad", "slide", "precise"),
    [
        ((0.3, 2.8), 0.1, 1e-8),
        ((1e-2, 0.1), 0.1, 1e-6),
        # An end that slides over the other ridge stops at a tenth of its own, larger distance.
        ((1e-8, 1e-3), 0.0, 0.02),
        ((0.0, 0.0), 0.0, 0.02),
    ],
    ids=["skew", "nearly parallel", "almost parallel", "parallel"],
)
def test_ridges_that_cross_stop_at_a_tenth_of_their_gap(
    angles_rad: tuple[float, float], slide: float, precise: float
) -> None:
    count, rng = 200, np.random.default_rng(1)
    angle = rng.uniform(*angles_rad, count)
    gap = 10.0 ** rng.uniform(-7, -4, count)
    ridges = Ridges(rng, angle, gap)
    closing = gap * 10.0 ** rng.uniform(-0.5, 2, count)
    slide_m = rng.uniform(-slide, slide, count) * HALF_M
    found = limits(ridges.x, ridges.closing(closing, slide_m))
    free = (1 - SLACKNESS) * gap / closing
    stopped = free < 1
    assert 100 < stopped.sum() < count
    assert found[stopped] == pytest.approx(free[stopped], rel=precise)
    assert np.all(found[stopped] < gap[stopped] / closing[stopped])
    assert np.all(found[~stopped] == 1.0)


@pytest.mark.parametrize("short", [1e-3, 1e-6, 1e-9, 0.0])
def test_a_ridge_that_is_hardly_a_line_stops_there_too(short: float) -> None:
    """One ridge, or both, so short that they have no direction to speak of."""
    rng = np.random.default_rng(2)
    gap = 10.0 ** rng.uniform(-6, -4, 100)
    for halves in ((short * HALF_M, HALF_M), (HALF_M, short * HALF_M), (short * HALF_M,) * 2):
        ridges = Ridges(rng, rng.uniform(0.5, 2.5, 100), gap, halves)
        found = limits(ridges.x, ridges.closing(2 * gap))
        assert found == pytest.approx((1 - SLACKNESS) / 2, rel=0.02)


def test_ridges_that_pass_or_part_do_not_stop() -> None:
    rng = np.random.default_rng(3)
    gap = 10.0 ** rng.uniform(-6, -4, 100)
    ridges = Ridges(rng, rng.uniform(0.5, 2.5, 100), gap)
    assert np.all(limits(ridges.x, ridges.closing(-3 * gap)) == 1.0)
    assert np.all(limits(ridges.x, ridges.closing(0 * gap, 0.1 * HALF_M)) == 1.0)


def test_a_limit_that_is_known_is_only_lowered() -> None:
    """What may be taken of a way says up to where pairs are looked at."""
    rng = np.random.default_rng(5)
    gap = 10.0 ** rng.uniform(-6, -4, 100)
    ridges = Ridges(rng, rng.uniform(0.5, 2.5, 100), gap)
    way = ridges.closing(gap * rng.uniform(0.5, 20, 100))
    alone = limits(ridges.x, way)
    np.testing.assert_array_equal(limits(ridges.x, way, most=0.08), np.minimum(alone, 0.08))
    assert 20 < (alone > 0.08).sum() < 80


def test_the_thickness_of_a_corner_and_of_a_face_is_kept() -> None:
    gap, thickness = np.geomspace(5e-6, 1e-4, 20), 2e-6
    x = np.zeros((20, 8, 3))
    x[:, 1:4] = [[HALF_M, 0, DEEP_M], [-HALF_M, HALF_M, DEEP_M], [-HALF_M, -HALF_M, DEEP_M]]
    x[:, 4:7] = 3 * x[:, 1:4] * [1, 1, 0]
    x[:, 7, 2] = -DEEP_M
    x[:, :4, 2] += gap[:, None]
    dx = np.zeros_like(x)
    dx[:, :4, 2] = -2 * gap[:, None]
    free = (1 - SLACKNESS) * (gap - 2 * thickness) / (2 * gap)
    assert limits(x, dx, thickness) == pytest.approx(free, rel=1e-8)


def test_the_thickness_of_both_is_kept() -> None:
    rng, thickness = np.random.default_rng(4), 2e-6
    gap = rng.uniform(5e-6, 1e-4, 50)
    ridges = Ridges(rng, rng.uniform(0.5, 2.5, 50), gap)
    found = limits(ridges.x, ridges.closing(2 * gap), thickness)
    assert found == pytest.approx((1 - SLACKNESS) * (gap - 2 * thickness) / (2 * gap), rel=1e-8)


def test_edges_that_turn_and_stretch_are_free_of_contact_up_to_the_limit() -> None:
    """Every node of the ridges goes its own way: the referee is ipctk's Tight-Inclusion."""
    count, rng = 300, np.random.default_rng(6)
    gap = 10.0 ** rng.uniform(-5.5, -3.5, count)
    ridges = Ridges(rng, rng.uniform(0.4, 2.7, count), gap)
    dx = ridges.closing(gap * rng.uniform(0.5, 5, count))
    dx[:, RIDGES] += rng.normal(size=(count, 4, 3)) * gap[:, None, None]
    found = limits(ridges.x, dx)
    referee = ipctk.TightInclusionCCD(tolerance=1e-10, conservative_rescaling=1 - 1e-6)
    starts, ends = ridges.x[:, RIDGES], (ridges.x + dx)[:, RIDGES]
    answers = [referee.edge_edge_ccd(*a, *b) for a, b in zip(starts, ends, strict=True)]
    expected = np.array([time if hit else np.inf for hit, time in answers])
    meets = np.isfinite(expected)
    assert meets.sum() > 150 and np.all(found[meets] < expected[meets])
    # A tenth of the gap is left; ridges may come as near before they meet.
    assert np.mean(found[meets] > 0.8 * expected[meets]) > 0.95
    assert np.mean(found[~meets] == 1.0) > 0.85
    for env in range(count):
        for part in np.linspace(0, found[env], 20):
            nodes = (ridges.x + part * dx)[env, RIDGES]
            assert ipctk.edge_edge_distance(*nodes) ** 0.5 > 0.099 * gap[env]
