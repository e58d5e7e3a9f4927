# SPDX-License-Identifier: Apache-2.0
"""Presses in frames of their own: the same press on a turned gel, domes pressed from the side."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.model.embedding import rotate
from taccel_lab.presses import PressEnv, PressPath, PressSetup, normal_frame, parse_indenter
from taccel_lab.presses.frame import PressFrames
from taccel_lab.presses.touch import gel_below_m
from taccel_lab.solvers import SolverConfig
from tests.support.coarse_pads import GEL, LINEAR, pad

BALL = parse_indenter("sphere:2")
UP = np.array([0.0, 0.0, 1.0])


@example((0.0, 1e-8, -0.5))
@example((0.0, 1e-170, -1.0))
@example((1e-12, 1e-9, -1.0))
@example((0.0, 0.0, -1.0))
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda way: math.hypot(*way) >= 0.1))
def test_normal_frame(way):
    normal = np.array(way) / np.linalg.norm(way)
    pose = normal_frame(np.array([1e-3, -2e-3, 3e-3]), normal)
    assert pose[:3].tolist() == [1e-3, -2e-3, 3e-3]
    assert np.linalg.norm(pose[3:]) == pytest.approx(1)
    assert rotate(pose[3:], UP) == pytest.approx(normal, abs=1e-9)
    # The least turn leaves the axis across both where it is.
    across = np.cross(UP, normal)
    assert rotate(pose[3:], across) == pytest.approx(across, abs=1e-9)


def env_in(frames: list | np.ndarray) -> PressEnv:
    return PressEnv(PressSetup(pad(), GEL, BALL), np.zeros((1, 2)), gel_from_press=np.array(frames))


@pytest.mark.parametrize(
    ("make", "given", "message"),
    [
        (normal_frame, ([0, 0, np.nan], [0, 0, 1]), "finite point and normal"),
        (normal_frame, ([0, 0, 0], [0, 0, 2]), "unit length, got 2"),
        (normal_frame, ([0, 0], [0, 0, 1]), "finite point and normal"),
        (env_in, (np.zeros((1, 7)),), "unit length"),
        (env_in, (np.zeros((2, 7)),), r"shape \[1, 7\], got \(2, 7\)"),
        (env_in, (np.full((1, 7), np.nan),), "finite"),
    ],
)
def test_bad_normals_and_frames(make, given, message):
    with pytest.raises((InputError, ValueError), match=message):
        make(*map(np.array, given))


def pressed(mesh: TetMesh, indenter: str, **frame: np.ndarray) -> PressEnv:
    setup = PressSetup(mesh, GEL, parse_indenter(indenter), 0.4, LINEAR)
    config = SolverConfig(relative_tolerance=1e-8)
    env = PressEnv(setup, np.array([[0.4, -0.2]]), config=config, **frame)
    env.follow(PressPath(0.3, (0.05, 0.02), 3.0, step_mm=0.3, step_deg=3.0))
    return env


@pytest.mark.thorough
@pytest.mark.parametrize("indenter", ["sphere:2", "edge:90x3"])
def test_a_press_turns_with_its_frame(indenter):
    mesh, turn = pad(), np.array([0.3, -0.5, 0.2, math.sqrt(0.62)])
    at = np.array([2e-3, -1e-3, 5e-3])
    straight = pressed(mesh, indenter)
    turned_mesh = TetMesh(rotate(turn, mesh.nodes_m) + at, mesh.tets, mesh.faces, mesh.face_regions)
    turned = pressed(turned_mesh, indenter, gel_from_press=np.concatenate([at, turn])[None])
    assert turned.touch_m == pytest.approx(straight.touch_m, abs=1e-12)
    assert turned.thickness_m == pytest.approx(straight.thickness_m, abs=1e-12)
    force = straight.wrench[0, :3]
    assert turned.press_force[0] == pytest.approx(force, abs=1e-5 * force[2])
    assert turned.wrench[0, :3] == pytest.approx(rotate(turn, force), abs=1e-5 * force[2])
    expected = rotate(turn, straight.positions[0]) + at
    assert turned.positions[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.thorough
def test_a_press_from_the_side_pushes_sideways():
    """The wall of a block, which is contact face too here, pressed along its normal."""
    block = block_mesh((6, 6, 4), (8e-3, 8e-3, 4e-3))
    regions = np.where(block.face_regions == Region.SIDE, Region.CONTACT, block.face_regions)
    mesh = TetMesh(block.nodes_m, block.tets, block.faces, regions)
    frame = normal_frame(np.array([4e-3, 0.0, -2e-3]), np.array([1.0, 0.0, 0.0]))
    env = PressEnv(PressSetup(mesh, GEL, BALL), np.zeros((1, 2)), gel_from_press=frame[None])
    assert env.poses[0, 0, 0] > 6e-3
    env.move_to(0.3)
    assert env.poses[0, 0, :3] == pytest.approx([5.7e-3 + env.setback_m[0], 0, -2e-3], abs=1e-9)
    assert env.wrench[0, 0] > 0.01
    assert abs(env.wrench[0, 2]) < 0.3 * env.wrench[0, 0]
    assert env.press_force[0, 2] == pytest.approx(env.wrench[0, 0])


def shell(inner_m: float, outer_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of half a spherical shell, its outer faces and its inner ones."""
    polar, turn = np.linspace(0.02, 1.5, 15), np.linspace(0, 2 * np.pi, 40, endpoint=False)
    a, b = np.meshgrid(polar, turn, indexing="ij")
    sphere = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(14), np.arange(40), indexing="ij")
    k, n = (i * 40 + j).ravel(), (i * 40 + (j + 1) % 40).ravel()
    faces = np.concatenate([np.stack([k, k + 40, n + 40], 1), np.stack([k, n + 40, n], 1)])
    return np.concatenate([outer_m * sphere, inner_m * sphere]), faces, faces + 600


def test_the_gel_of_a_shell_is_its_thickness():
    nodes, outer, inner = shell(10e-3, 12.5e-3)
    for tilt in np.radians([10.0, 45.0, 70.0]):
        normal = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        frame = normal_frame(12.5e-3 * normal, normal)
        seen = rotate(frame[3:] * [-1, -1, -1, 1], nodes - frame[:3])
        assert gel_below_m(seen, outer, inner, np.zeros(2)) == pytest.approx(2.5e-3, rel=0.02)
    # Straight down near the rim the axis misses the inner sphere: the nearest bond counts.
    assert 2.4e-3 < gel_below_m(nodes, outer, inner, np.array([12e-3, 0.0])) < 2.7e-3


def test_turns_by_rotation_vectors():
    """A turn about z as an angle and as a vector is the same; a roll turns the body about its
    origin, which stays."""
    frames, place = PressFrames(None, 2), np.array([[1e-3, 2e-3, 3e-3], [0.0, 0.0, 1e-3]])
    angles = np.array([0.3, -1.2])
    vectors = angles[:, None] * UP
    assert frames.poses_in_gel(place, vectors) == pytest.approx(frames.poses_in_gel(place, angles))
    rolled = frames.poses_in_gel(place, np.array([[0.0, 0.5, 0.0], [0.0, 0.0, 0.0]]))
    assert rolled[:, :3].tolist() == place.tolist()
    top = rotate(rolled[:, 3:], UP)
    assert top[0] == pytest.approx([math.sin(0.5), 0.0, math.cos(0.5)])
    assert top[1].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.thorough
def test_a_ball_that_rolls_keeps_its_force():
    """Rolling on by radius times angle drags the gel along far less than sliding as far."""
    env = PressEnv(PressSetup(pad(), GEL, BALL, 0.8, LINEAR), np.zeros((2, 2)))
    env.move_to(0.2)
    shear = np.array([[2.0 * math.radians(6.0), 0.0]] * 2)
    report = env.try_to(0.2, shear, np.array([[0.0, 6.0, 0.0], [0.0, 0.0, 0.0]]))
    assert report.converged.all()
    rolled, slid = np.hypot(*env.press_force[:, :2].T)
    assert rolled < 0.2 * slid
