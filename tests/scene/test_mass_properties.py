# SPDX-License-Identifier: Apache-2.0
"""Mass properties of closed meshes against closed forms, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.bodies.mass_properties import StatedMass, mass_properties, with_stated_mass
from taccel_lab.bodies.primitives import TriangleMesh, box_mesh, cylinder_mesh, sphere_mesh
from taccel_lab.errors import InputError
from tests.support.turns import random_turns

RHO = 1234.0
TET = TriangleMesh(
    np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)


def moved(mesh: TriangleMesh, turn: np.ndarray, shift: np.ndarray) -> TriangleMesh:
    return TriangleMesh(mesh.vertices_m @ turn.T + shift, mesh.faces)


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    starts = np.cumsum([0] + [len(m.vertices_m) for m in meshes[:-1]])
    return TriangleMesh(
        np.concatenate([m.vertices_m for m in meshes]),
        np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=True)]),
    )


def flipped(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices_m, mesh.faces[:, ::-1])


def test_box() -> None:
    a, b, c = size = (0.1, 0.02, 0.003)
    found = mass_properties(box_mesh(size), RHO)
    mass = RHO * a * b * c
    assert found.volume_m3 == pytest.approx(a * b * c, rel=1e-14)
    assert found.mass_kg == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(found.center_m, 0, atol=1e-17)
    np.testing.assert_array_equal(found.axes, np.eye(3))
    moments = mass * np.array(size) ** 2 / 12
    np.testing.assert_allclose(found.second_moments_kg_m2, moments, rtol=1e-13)
    inertia = mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(found.inertia_kg_m2, inertia, rtol=1e-13, atol=0)
    assert found.radius_m == pytest.approx(np.linalg.norm(size) / 2, rel=1e-14)


def test_corner_tetrahedron() -> None:
    """int x^2 = 1/60, int xy = 1/120, int x = 1/24 over the unit corner tet."""
    found = mass_properties(TET, 1.0)
    assert found.volume_m3 == pytest.approx(1 / 6, rel=1e-14)
    np.testing.assert_allclose(found.center_m, 0.25, rtol=1e-14)
    raw = (1 / 60 - 1 / 120) * np.eye(3) + 1 / 120 - np.full((3, 3), 1 / 16 / 6)
    again = (found.axes * found.second_moments_kg_m2) @ found.axes.T
    np.testing.assert_allclose(again, raw, atol=1e-16)


def test_cylinder_of_many_sides() -> None:
    n, r, h = 48, 0.01, 0.03
    found = mass_properties(cylinder_mesh(r, h, n), RHO)
    step = 2 * np.pi / n
    area = n / 2 * r * r * np.sin(step)
    mass = RHO * area * h
    across = mass * r * r * (2 + np.cos(step)) / 12
    assert found.mass_kg == pytest.approx(mass, rel=1e-13)
    expected = [across, across, mass * h * h / 12]
    np.testing.assert_allclose(found.second_moments_kg_m2, expected, rtol=1e-12)


def test_sphere_meshes_converge_to_the_ball() -> None:
    r = 0.02
    ball = np.array([4 / 3 * np.pi * r**3, 4 / 15 * np.pi * r**5])
    errors = []
    for edge in (1e-2, 5e-3, 2.5e-3):
        found = mass_properties(sphere_mesh(r, edge), 1.0)
        values = np.array([found.volume_m3, found.second_moments_kg_m2.mean()])
        errors.append(np.abs(values / ball - 1))
        np.testing.assert_allclose(found.second_moments_kg_m2, values[1], rtol=1e-12)
    first, second, third = errors
    assert (second < first / 3.5).all() and (third < second / 3.5).all() and (third < 0.01).all()


@given(
    seed=st.integers(0, 2**31),
    size=st.tuples(*[st.floats(1e-3, 1.0)] * 3),
    far=st.floats(-1.0, 3.0),
)
def test_a_moved_body(seed: int, size: tuple[float, float, float], far: float) -> None:
    mesh = box_mesh(size)
    turn, shift = random_turns(seed, 1)[0], np.random.default_rng(seed).normal(size=3) * 10**far
    still, found = mass_properties(mesh, RHO), mass_properties(moved(mesh, turn, shift), RHO)
    # Moving rounds the vertices themselves to eps * shift, which the thinnest edge sees.
    loss = 1e-13 + 1e-15 * np.abs(shift).max() / min(size)
    assert found.mass_kg == pytest.approx(still.mass_kg, rel=10 * loss)
    np.testing.assert_allclose(
        np.sort(found.second_moments_kg_m2), np.sort(still.second_moments_kg_m2), rtol=100 * loss
    )
    np.testing.assert_allclose(found.center_m, shift, atol=1e-14 * (1 + np.abs(shift).max()))
    np.testing.assert_allclose(found.axes.T @ found.axes, np.eye(3), atol=1e-14)
    assert np.linalg.det(found.axes) == pytest.approx(1, abs=1e-13)
    inertia = turn @ still.inertia_kg_m2 @ turn.T
    np.testing.assert_allclose(
        found.inertia_kg_m2, inertia, atol=100 * loss * np.abs(inertia).max()
    )


def test_cavity_and_separate_shells() -> None:
    outer, inner = box_mesh((0.2, 0.2, 0.2)), box_mesh((0.1, 0.1, 0.1))
    hollow = mass_properties(joined(outer, flipped(inner)), RHO)
    assert hollow.mass_kg == pytest.approx(RHO * (8e-3 - 1e-3), rel=1e-13)
    np.testing.assert_allclose(
        hollow.second_moments_kg_m2, RHO * (0.2**5 - 0.1**5) / 12, rtol=1e-12
    )
    apart = joined(inner, moved(inner, np.eye(3), np.array([1.0, 0, 0])))
    found = mass_properties(apart, RHO)
    np.testing.assert_allclose(found.center_m, [0.5, 0, 0], atol=1e-15)
    assert found.second_moments_kg_m2[0] == pytest.approx(RHO * (2e-3 * 0.25 + 2e-5 / 12))


APART = joined(TET, flipped(moved(TET, np.eye(3), np.array([3.0, 0, 0]))))


@pytest.mark.parametrize(
    ("mesh", "density", "words"),
    [
        (TriangleMesh(TET.vertices_m, TET.faces[1:]), RHO, r"not closed: 3 edges.*\(0, 1\)"),
        (flipped(TET), RHO, "oriented inwards"),
        (TriangleMesh(TET.vertices_m * [1, 1, 0], TET.faces), RHO, "encloses no volume"),
        (TriangleMesh(np.zeros((4, 3)), TET.faces), RHO, "single point"),
        (joined(box_mesh((0.2, 0.2, 0.2)), box_mesh((0.1, 0.1, 0.1))), RHO, "inside another shell"),
        (APART, RHO, "face 4.*oriented inwards"),
        *((TET, rho, "density must be positive") for rho in (0.0, -1.0, np.nan, np.inf)),
    ],
)
def test_bad_solids_are_refused(mesh: TriangleMesh, density: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        mass_properties(mesh, density)


def test_stated_mass_of_an_even_solid_is_that_of_its_density() -> None:
    mesh = moved(box_mesh((0.03, 0.02, 0.01)), random_turns(3, 1)[0], np.array([0.1, -0.2, 0.3]))
    even = mass_properties(mesh, 800.0)
    stated = StatedMass(even.mass_kg, even.center_m, even.inertia_kg_m2)
    found = with_stated_mass(mass_properties(mesh, 1.0), stated, mesh)
    assert found.volume_m3 == even.volume_m3 and found.mass_kg == even.mass_kg
    assert found.radius_m == pytest.approx(even.radius_m)
    np.testing.assert_allclose(found.inertia_kg_m2, even.inertia_kg_m2, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        np.sort(found.second_moments_kg_m2), np.sort(even.second_moments_kg_m2), rtol=1e-9
    )
    assert np.linalg.det(found.axes) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("mass", "center", "inertia", "words"),
    [
        (0.0, np.zeros(3), np.eye(3), "mass must be positive and finite, got 0 kg"),
        (np.nan, np.zeros(3), np.eye(3), "mass must be positive"),
        (1.0, np.zeros(2), np.eye(3), "shape"),
        (1.0, np.array([0, np.nan, 0]), np.eye(3), "NaN or infinite"),
        (1.0, np.zeros(3), np.diag([1.0, 2.0, 3.0]), "that of no solid"),
        (1.0, np.zeros(3), np.diag([0.0, 2.0, 2.0]), "that of no solid"),
        (1.0, np.zeros(3), np.eye(3) + np.eye(3, k=1) / 9, "must be symmetric"),
    ],
)
def test_bad_stated_mass(mass: float, center: np.ndarray, inertia: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        StatedMass(mass, center, inertia)
