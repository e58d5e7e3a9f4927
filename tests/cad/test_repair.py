# SPDX-License-Identifier: Apache-2.0
"""Repair of surfaces with pymeshlab, and the answer when it is not installed."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.repair import repair_surface, self_intersections
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.errors import InputError
from tests.cad.cubes import FACES, UNIT

Soup = tuple[np.ndarray, np.ndarray]
Spoil = Callable[[np.ndarray, np.ndarray], Soup]


def test_missing_pymeshlab_names_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymeshlab", None)
    with pytest.raises(InputError, match=r"pip install .*repair"):
        repair_surface(UNIT, FACES)


@pytest.fixture(scope="module")
def clean() -> Soup:
    """The surface of a dome shell [mm]: closed, curved, of even triangles."""
    pytest.importorskip("pymeshlab")
    mesh = gel_mesh(ShellDomePad(dome_radius_mm=8, thickness_mm=2, opening_deg=60), 1.2)
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return mesh.nodes_m[used] * 1e3, faces.reshape(mesh.faces.shape)


def volume(points: np.ndarray, faces: np.ndarray) -> float:
    return float(np.linalg.det(points[faces]).sum() / 6)


def test_a_clean_surface_stays_as_it_is(clean: Soup) -> None:
    found = repair_surface(*clean)
    assert found.actions == ()
    assert len(found.vertices) == len(clean[0]) and len(found.triangles) == len(clean[1])
    assert volume(found.vertices, found.triangles) == pytest.approx(volume(*clean), rel=1e-12)
    assert not self_intersections(*clean).any()
    # A dent of a hundredth of a millimetre across two close vertices stays.
    shifted = clean[0].copy()
    shifted[0] += 0.01
    found = repair_surface(shifted, clean[1])
    assert found.actions == ()
    assert np.abs(found.vertices - shifted).max() < 1e-9


def apex(points: np.ndarray, move: float) -> np.ndarray:
    """Points with another height of the highest one."""
    spoiled = points.copy()
    spoiled[int(points[:, 2].argmax()), 2] += move
    return spoiled


def fin(points: np.ndarray, faces: np.ndarray) -> Soup:
    a, b, c = faces[int(points[faces].mean(axis=1)[:, 2].argmax())]
    tip = points[[a, b, c]].mean(axis=0) + [0, 0, 1.5]
    return np.concatenate([points, [tip]]), np.concatenate([faces, [[a, b, len(points)]]])


def debris(points: np.ndarray, faces: np.ndarray) -> Soup:
    tet = 0.2 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + [20, 0, 0]
    own = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]) + len(points)
    return np.concatenate([points, tet]), np.concatenate([faces, own])


def some_turned(points: np.ndarray, faces: np.ndarray) -> Soup:
    mixed = faces.copy()
    mixed[::7] = mixed[::7, ::-1]
    return points, mixed


def hole(points: np.ndarray, faces: np.ndarray) -> Soup:
    top = np.argsort(points[faces].mean(axis=1)[:, 2])[-4:]
    return points, np.delete(faces, top, axis=0)


@pytest.mark.parametrize(
    ("spoil", "done"),
    [
        (
            lambda p, f: (p[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3)),
            "merged .* vertices of the same place",
        ),
        (lambda p, f: (apex(p, np.nan), f), "cut out 6 triangles with NaN"),
        (hole, "closed holes of 8 edges with 4 triangles"),
        (lambda p, f: (p, np.concatenate([f, f[5:9, [1, 2, 0]]])), "cut out 4 duplicate triangles"),
        (lambda p, f: (p, np.concatenate([f, f[10:11, [0, 1, 1]]])), "cut out 1 .* without area"),
        (fin, "took apart .* edges"),
        (debris, "cut out 1 loose pieces of 4 triangles"),
        (lambda p, f: (p, f[:, ::-1]), "faces outward"),
        (some_turned, "turned .* triangles"),
        (lambda p, f: (apex(p, -2.6), f), "triangles that pass through others"),
    ],
)
def test_planted_defects_are_repaired_and_named(clean: Soup, spoil: Spoil, done: str) -> None:
    found = repair_surface(*spoil(*clean))
    assert any(re.search(done, action) for action in found.actions), found.actions
    check_closed(found.triangles, "it")
    assert not self_intersections(found.vertices, found.triangles).any()
    assert volume(found.vertices, found.triangles) == pytest.approx(volume(*clean), rel=0.03)


def folded(points: np.ndarray, faces: np.ndarray) -> Soup:
    """Everything beyond a plane mirrored back through the body."""
    x = points[:, :1]
    return np.concatenate([np.where(x > 0, -0.7 * x, x), points[:, 1:]], axis=1), faces


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda p, f: (p * [1, 1, 1e-4], f), "thick at x"),
        (
            lambda p, f: (np.concatenate([p, p + 30]), np.concatenate([f, f + len(p)])),
            "2 separate pieces",
        ),
        (
            lambda p, f: (p, f[p[f].mean(axis=1)[:, 0] < 0]),
            "open edges are left, at holes of more than 12 edges",
        ),
        (folded, "passes through itself in .* triangles around x"),
        (lambda *_: (UNIT * np.nan, FACES), "."),
        (lambda *_: (UNIT, FACES + 5), "."),
        (lambda *_: (UNIT, FACES[:0]), "."),
        (lambda *_: (UNIT * 0, FACES), "."),
    ],
)
def test_what_cannot_be_repaired_is_refused(clean: Soup, spoil: Spoil, words: str) -> None:
    with pytest.raises(InputError, match=words):
        repair_surface(*spoil(*clean), max_hole_edges=12)
