# SPDX-License-Identifier: Apache-2.0
"""How far a step may go when ridges meet: edge pairs alone limit it, never late, hardly early.

Two tets lie with an edge of each, their ridges, next to one another; all other nodes are far off.
Where the ridges cross inside of both, they touch when the gap along their common normal is gone.
"""

from __future__ import annotations

from dataclasses import dataclass

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.contact.step_limit import limit_checks
from taccel_lab.model import Model
from taccel_lab.scene import Element, Material, Scene, SoftBody, Surface, TimeStepping
from tests.support.turns import random_turns

HALF_M, DEEP_M = 1e-3, 2e-3
"""Half the length of a ridge, and how far the rest of its tet lies behind it."""
SLACKNESS = 0.1
"""Part of the gap that is left, see ``limit_checks``."""


def tet() -> TetMesh:
    nodes = np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 2], [0, -1, 2]]) * HALF_M
    tets = np.array([[0, 1, 2, 3]])
    faces = boundary_faces(tets)
    return TetMesh(nodes, tets, faces, np.zeros(len(faces), dtype=np.int64))


def model(env_count: int, thickness_m: float = 0.0) -> Model:
    """Two tets: nodes 0 and 1 are the ridge of one, 4 and 5 that of the other."""
    nothing = np.zeros(0, dtype=np.int64)
    bodies = [
        SoftBody(
            tet(),
            Material(1e5, 0.4),
            bonded_nodes=nothing,
            name=name,
            element=Element.LINEAR,
            surface=Surface(thickness_m=thickness_m),
            initial_pose=np.array([0, 0, z, 0, 0, 0, 1.0]),
        )
        for name, z in (("upper", 1.0), ("lower", -1.0))
    ]
    return Scene(bodies, env_count=env_count, time=TimeStepping(quasi_static=False)).finalize()


def limits(
    made: Model, x: np.ndarray, dx: np.ndarray, active: np.ndarray | None = None
) -> np.ndarray:
    """Fraction of the displacements, shape [env]; that of inactive environments stays -1."""
    chosen = np.ones(len(x), dtype=np.int32) if active is None else active
    flags = wp.array(chosen, dtype=wp.int32)
    positions, way = wp.array(x, dtype=wp.vec3d), wp.array(dx, dtype=wp.vec3d)
    poses = wp.zeros((len(x), 0), dtype=wp.transformd)
    candidates = Candidates(made)
    candidates.update(flags, positions, way, poses, poses, 1e-6)
    found = wp.array(np.where(chosen != 0, 1.0, -1.0), dtype=wp.float64)
    for check in limit_checks(made, flags, candidates, positions, way, found, SLACKNESS):
        check()
    return found.numpy()


def unit(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@dataclass(frozen=True)
class Ridges:
    """Ridges above one another, before they move."""

    x: np.ndarray
    """[env, 8, 3] [m]."""
    normal: np.ndarray
    """From the lower ridge to the upper one, [env, 3]."""
    along: np.ndarray
    """Direction of the upper ridge, [env, 3]."""


def crossing(
    rng: np.random.Generator,
    angle_rad: np.ndarray,
    gap_m: np.ndarray,
    halves_m: tuple[float, float] = (HALF_M, HALF_M),
) -> Ridges:
    """Ridges that cross anywhere in their inner four fifths, in any direction of space."""
    count = len(angle_rad)
    zero = np.zeros(count)
    first = np.stack([np.ones(count), zero, zero], axis=1)
    second = np.stack([np.cos(angle_rad), np.sin(angle_rad), zero], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    x = np.zeros((count, 8, 3))
    for start, ridge, half, side in ((0, first, halves_m[0], 1.0), (4, second, halves_m[1], -1.0)):
        middle = rng.uniform(-0.8, 0.8, (count, 1)) * half * ridge
        x[:, start] = middle - half * ridge
        x[:, start + 1] = middle + half * ridge
        across = np.cross(up, ridge)
        for node, way in ((start + 2, side), (start + 3, -side)):
            x[:, node] = middle + way * HALF_M * across + side * DEEP_M * up
    x[:, :4] += gap_m[:, None, None] * up
    turned = random_turns(rng, count)
    x = np.einsum("eij,enj->eni", turned, x)
    return Ridges(x, turned[:, :, 2], turned[:, :, 0])


def translated(
    rng: np.random.Generator, ridges: Ridges, closing_m: np.ndarray, slide_m: np.ndarray
) -> np.ndarray:
    """Both bodies move, each by a part, and share a drift; they slide along the upper ridge."""
    relative = -closing_m[:, None] * ridges.normal + slide_m[:, None] * ridges.along
    part = rng.uniform(0, 1, (len(closing_m), 1))
    drift = 1e-3 * unit(rng, len(closing_m))
    dx = np.zeros_like(ridges.x)
    dx[:, :4] = (drift + part * relative)[:, None]
    dx[:, 4:] = (drift - (1 - part) * relative)[:, None]
    return dx


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
    ridges = crossing(rng, angle, gap)
    closing = gap * 10.0 ** rng.uniform(-0.5, 2, count)
    slide_m = rng.uniform(-slide, slide, count) * HALF_M
    found = limits(model(count), ridges.x, translated(rng, ridges, closing, slide_m))
    free = (1 - SLACKNESS) * gap / closing
    stopped = free < 1
    assert 100 < stopped.sum() < count
    assert found[stopped] == pytest.approx(free[stopped], rel=precise)
    assert np.all(found[stopped] < gap[stopped] / closing[stopped])
    assert np.all(found[~stopped] == 1.0)


@pytest.mark.parametrize("short", [1e-3, 1e-6, 1e-9, 0.0])
def test_a_ridge_that_is_hardly_a_line_stops_there_too(short: float) -> None:
    """One ridge, or both, so short that they have no direction to speak of."""
    count, rng = 100, np.random.default_rng(2)
    gap = 10.0 ** rng.uniform(-6, -4, count)
    for halves in ((short * HALF_M, HALF_M), (HALF_M, short * HALF_M), (short * HALF_M,) * 2):
        ridges = crossing(rng, rng.uniform(0.5, 2.5, count), gap, halves)
        found = limits(model(count), ridges.x, translated(rng, ridges, 2 * gap, 0 * gap))
        assert found == pytest.approx((1 - SLACKNESS) / 2, rel=0.02)


def test_ridges_that_pass_or_part_do_not_stop() -> None:
    count, rng = 100, np.random.default_rng(3)
    gap = 10.0 ** rng.uniform(-6, -4, count)
    ridges = crossing(rng, rng.uniform(0.5, 2.5, count), gap)
    made = model(count)
    for closing, slide in ((-3 * gap, 0 * gap), (0 * gap, 0.1 * HALF_M + 0 * gap)):
        found = limits(made, ridges.x, translated(rng, ridges, closing, slide))
        assert np.all(found == 1.0)


def test_the_thickness_of_both_is_kept() -> None:
    count, rng, thickness = 50, np.random.default_rng(4), 2e-6
    gap = rng.uniform(5e-6, 1e-4, count)
    ridges = crossing(rng, rng.uniform(0.5, 2.5, count), gap)
    dx = translated(rng, ridges, 2 * gap, 0 * gap)
    found = limits(model(count, thickness), ridges.x, dx)
    spare = gap - 2 * thickness
    assert found == pytest.approx((1 - SLACKNESS) * spare / (2 * gap), rel=1e-8)


def test_edges_that_turn_and_stretch_are_free_of_contact_up_to_the_limit() -> None:
    """Every node of the ridges goes its own way: the referee is ipctk's Tight-Inclusion."""
    count, rng = 300, np.random.default_rng(6)
    gap = 10.0 ** rng.uniform(-5.5, -3.5, count)
    ridges = crossing(rng, rng.uniform(0.4, 2.7, count), gap)
    dx = translated(rng, ridges, gap * rng.uniform(0.5, 5, count), 0 * gap)
    own = np.zeros_like(dx)
    own[:, [0, 1, 4, 5]] = rng.normal(size=(count, 4, 3)) * gap[:, None, None]
    dx += own
    found = limits(model(count), ridges.x, dx)
    referee = ipctk.TightInclusionCCD(tolerance=1e-10, conservative_rescaling=1 - 1e-6)
    pair = [0, 1, 4, 5]
    expected = np.full(count, np.inf)
    for env in range(count):
        start, end = ridges.x[env, pair], (ridges.x + dx)[env, pair]
        hit, time = referee.edge_edge_ccd(*start, *end)
        if hit:
            expected[env] = time
    meets = np.isfinite(expected)
    assert meets.sum() > 150
    assert np.all(found[meets] < expected[meets])
    # A tenth of the gap is left; ridges may come as near before they meet.
    assert np.mean(found[meets] > 0.8 * expected[meets]) > 0.95
    assert np.mean(found[~meets] == 1.0) > 0.85
    for env in range(count):
        for part in np.linspace(0, found[env], 20):
            nodes = (ridges.x + part * dx)[env, pair]
            assert ipctk.edge_edge_distance(*nodes) ** 0.5 > 0.099 * gap[env]
