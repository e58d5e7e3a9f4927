# SPDX-License-Identifier: Apache-2.0
"""The broad phase against all pairs: no pair that comes within the margin may be missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.broad_phase.held_patches import hull_corners
from taccel_lab.model import Model
from taccel_lab.model.kinematics import interpolate_poses
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene

MESH = block_mesh((3, 3, 1), (3e-3, 3e-3, 1e-3), jitter=0.2)
BODY = bumpy_body(2, 0.8e-3)
BALL = Ball(0.7e-3)


def build() -> Model:
    return scene(
        MESH, KinematicBody(BODY, name="mesh"), KinematicBody(BALL, name="ball")
    ).finalize()


def box_gaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest separation along an axis of the boxes of primitives [n, k, 3] and [m, k, 3]."""
    low_a, high_a, low_b, high_b = a.min(1), a.max(1), b.min(1), b.max(1)
    return np.maximum(low_a[:, None] - high_b[None], low_b[None] - high_a[:, None]).max(axis=-1)


def found(candidates: Candidates) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """Node-face and edge-edge pairs of environment 0."""
    faces, edges = (part.of(0, part.pairs) for part in candidates.lists)
    pairs = set(map(tuple, faces.tolist())), set(map(tuple, edges.tolist()))
    assert len(pairs[0]) == len(faces) and len(pairs[1]) == len(edges), "a pair came twice"
    return pairs


def nearby(model: Model, x: np.ndarray, margin: float) -> tuple[set, set]:
    """Pairs whose boxes, in a frame where they are tight, are within the margin at positions x."""
    faces, edges = model.surface.faces.numpy(), model.surface.edges.numpy()
    gel, body, ball = model.bodies
    soft, body_faces = faces[slice(*gel.faces)], faces[slice(*body.faces)]
    nodes = np.unique(soft)
    pairs = set()
    gaps = box_gaps(x[nodes][:, None], x[body_faces])
    pairs |= {(int(nodes[i]), int(body.faces[0] + j)) for i, j in np.argwhere(gaps < margin)}
    vertices = np.arange(*body.nodes)
    gaps = box_gaps(x[vertices][:, None], x[soft])
    pairs |= {(int(vertices[i]), int(j)) for i, j in np.argwhere(gaps < margin)}
    centre = ball.nodes[0]
    gaps = box_gaps(x[centre][None, None], x[soft])[0] - BALL.radius_m
    pairs |= {(centre, int(j)) for j in np.flatnonzero(gaps < margin)}
    gaps = box_gaps(x[edges[slice(*gel.edges)]], x[edges[slice(*body.edges)]])
    return pairs, {(int(i), int(body.edges[0] + j)) for i, j in np.argwhere(gaps < margin)}


def true_distances(model: Model, x: np.ndarray, pairs: set[tuple[int, int]]) -> dict:
    """Distance of node-face pairs less a ball's radius, by ipctk."""
    import ipctk

    faces, radii = model.surface.faces.numpy(), model.surface.node_radii.numpy()
    return {
        (n, f): ipctk.point_triangle_distance(x[n], *x[faces[f]]) ** 0.5 - radii[n]
        for n, f in pairs
    }


def edge_distances(model: Model, x: np.ndarray, pairs: set[tuple[int, int]]) -> dict:
    import ipctk

    edges = model.surface.edges.numpy()
    return {(a, b): ipctk.edge_edge_distance(*x[edges[a]], *x[edges[b]]) ** 0.5 for a, b in pairs}


@settings(max_examples=25)
@example(
    seed=5753,
    margin=0.00012563245055716122,
    turn=28.0,
    reach=0.000788563487232224,
    behind=False,
)
@example(seed=3, margin=5e-5, turn=20.0, reach=3e-4, behind=True)
@given(
    seed=st.integers(0, 10_000),
    margin=st.floats(1e-6, 5e-4),
    turn=st.floats(0, 60),
    reach=st.floats(0, 1e-3),
    behind=st.booleans(),
)
def test_no_pair_is_missed_on_the_way(
    seed: int, margin: float, turn: float, reach: float, behind: bool
) -> None:
    """From above the gel or from behind, where its nodes are held."""
    rng = np.random.default_rng(seed)
    model = build()
    start = everywhere(
        1,
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.9e-3, tuple(rng.normal(size=3)), 50),
        pose(*rng.uniform(-1e-3, 1e-3, 2), 0.8e-3),
    )
    if behind:
        start[..., 2] = -1e-3 - start[..., 2]
    end = start.copy()
    end[0, :, :3] += rng.uniform(-reach, reach, (2, 3))
    end[0, 0] = interpolate_poses(
        end,
        everywhere(1, pose(*end[0, 0, :3], tuple(rng.normal(size=3)), 180), end[0, 1]),
        np.array([turn / 180]),
    )[0, 0]
    x = initial_state(model, start).positions.numpy()
    target = initial_state(model, end).positions.numpy()
    displacement = target - x
    soft = slice(0, model.soft_count)
    displacement[0, soft] = rng.uniform(-reach, reach, (model.soft_count, 3))
    displacement[0, MESH.bonded_nodes()] = 0.0
    cosines = np.abs(np.einsum("ebi,ebi->eb", start[..., 3:], end[..., 3:]))
    angle = 2 * np.arccos(np.minimum(cosines, 1)).max()
    chord_error = model.kinematic_radii_m.max() * (1 - np.cos(angle / 2))

    candidates = Candidates(model, room=64)
    candidates.update(
        wp.array([1], dtype=wp.int32),
        wp.array(x, dtype=wp.vec3d),
        wp.array(displacement, dtype=wp.vec3d),
        wp.array(start, dtype=wp.transformd),
        wp.array(end, dtype=wp.transformd),
        margin + chord_error,
    )
    node_face, edge_edge = found(candidates)
    missed = []
    for t in (0.0, 0.3, 0.7, 1.0):
        now = x[0] + t * displacement[0]
        near_faces, near_edges = nearby(model, now, margin)
        close = true_distances(model, now, near_faces - node_face)
        missed += [pair for pair, d in close.items() if d < margin]
        close = edge_distances(model, now, near_edges - edge_edge)
        missed += [pair for pair, d in close.items() if d < margin]
    assert not missed


def test_pairs_far_away_are_left_out() -> None:
    model = build()
    start = everywhere(1, pose(0, 0, 0.9e-3), pose(1e-3, 1e-3, 0.8e-3))
    x = initial_state(model, start).positions
    still = wp.zeros_like(x)
    poses = wp.array(start, dtype=wp.transformd)
    candidates = Candidates(model)
    candidates.update(wp.array([1], dtype=wp.int32), x, still, poses, poses, 1e-4)
    node_face, edge_edge = found(candidates)
    gel = model.bodies[0]
    soft_nodes = np.unique(model.surface.faces.numpy()[slice(*gel.faces)])
    all_pairs = len(soft_nodes) * len(BODY.faces) + len(BODY.vertices_m) * gel.faces[1]
    assert 0 < len(node_face) < 0.1 * all_pairs
    assert 0 < len(edge_edge) < 0.1 * len(unique_edges(BODY.faces)) * gel.edges[1]
    far = everywhere(1, pose(0, 0, 9e-3), pose(0, 0, 12e-3))
    y = initial_state(model, far).positions
    away = wp.array(far, dtype=wp.transformd)
    candidates.update(wp.array([1], dtype=wp.int32), y, still, away, away, 1e-4)
    assert [part.counts.numpy()[0] for part in candidates.lists] == [0, 0]


def test_corners_hold_a_patch() -> None:
    """Whatever its shape: the box of the corners, widened by the slack, is that of all points."""
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-1, 1, (50, 2)), np.zeros(50)])
    patches = [
        rng.normal(size=(50, 3)),
        flat,
        flat + 1e-8 * rng.normal(size=flat.shape),
        np.outer(np.linspace(0, 1, 9), [1.0, 2.0, 3.0]),
        np.zeros((3, 3)),
        np.eye(3)[:2],
    ]
    for points in patches:
        turned = 1e-3 * points @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.normal(size=3)
        corners, slack = hull_corners(turned)
        held = turned[corners]
        assert (turned.min(axis=0) >= held.min(axis=0) - slack).all()
        assert (turned.max(axis=0) <= held.max(axis=0) + slack).all()
        assert slack < 1e-9
    assert len(hull_corners(flat)[0]) < 20
    assert len(hull_corners(patches[3])[0]) == 2


def test_a_turn_in_one_environment_leaves_the_others_as_alone() -> None:
    """By 2 rad there is no bound on the path of a body in the frame of another: everything is a
    candidate, where it turns. The gels may touch each other, too."""

    def search(turns: list[float]) -> list[list[np.ndarray]]:
        """Pairs of faces and of edges in each environment."""
        above = replace(MESH, nodes_m=MESH.nodes_m + [0, 0, 1.05e-3])
        gels = [
            SoftBody(mesh, Material(1e5, 0.4), name=name, element=Element.LINEAR)
            for mesh, name in ((MESH, "low"), (above, "high"))
        ]
        model = Scene(gels, KinematicBody(BODY, name="mesh"), len(turns)).finalize()
        start = everywhere(len(turns), pose(1.5e-3, 1.5e-3, 1.9e-3))
        end = np.stack(
            [pose(1.5e-3, 1.5e-3, 1.9e-3, (1, 2, 3), np.degrees(turn))[None] for turn in turns]
        )
        x = initial_state(model, start).positions
        way = initial_state(model, end).positions.numpy() - x.numpy()
        candidates = Candidates(model, room=16)
        candidates.update(
            wp.full(len(turns), 1, dtype=wp.int32),
            x,
            wp.array(way, dtype=wp.vec3d),
            wp.array(start, dtype=wp.transformd),
            wp.array(end, dtype=wp.transformd),
            1e-4,
        )
        return [
            [np.array(part.of(env, part.pairs)) for part in candidates.lists]
            for env in range(len(turns))
        ]

    together = search([0.1, 2.0, 0.1, 0.0])
    assert len(together[1][1]) > 20 * len(together[0][1]) > 0
    for env, turn in ((0, 0.1), (2, 0.1), (3, 0.0)):
        (alone,) = search([turn])
        for found, expected in zip(together[env], alone, strict=True):
            assert len(found) > 0
            np.testing.assert_array_equal(found, expected)
