# SPDX-License-Identifier: Apache-2.0
"""Repair of surfaces with pymeshlab, and the answer when it is not installed."""

from __future__ import annotations

import builtins
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.cad.mesh.repair import repair_surface, self_intersections
from taccel_lab.cad.mesh.surface import check_closed
from taccel_lab.cad.parts.dome_pad import ShellDomePad
from taccel_lab.errors import InputError

CUBE = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
FACES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])


def test_missing_pymeshlab_names_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *args: Any, **kwargs: Any) -> Any:
        if name == "pymeshlab":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"pip install .*repair"):
        repair_surface(CUBE, FACES)


@pytest.fixture(scope="module")
def clean() -> tuple[np.ndarray, np.ndarray]:
    """The surface of a dome shell [mm]: closed, curved, of even triangles."""
    pytest.importorskip("pymeshlab")
    pad = ShellDomePad(dome_radius_mm=8, thickness_mm=2, opening_deg=60)
    mesh = gel_mesh(pad, 1.2)
    used, faces = np.unique(mesh.faces, return_inverse=True)
    return mesh.nodes_m[used] * 1e3, faces.reshape(mesh.faces.shape)


def volume(points: np.ndarray, faces: np.ndarray) -> float:
    corners = points[faces]
    return float((corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def test_a_clean_surface_stays_as_it_is(clean: tuple[np.ndarray, np.ndarray]) -> None:
    found = repair_surface(*clean)
    assert found.actions == ()
    assert len(found.vertices) == len(clean[0]) and len(found.triangles) == len(clean[1])
    assert volume(found.vertices, found.triangles) == pytest.approx(volume(*clean), rel=1e-12)
    assert not self_intersections(*clean).any()


Defect = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _loose(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def _nan(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spoiled = points.copy()
    spoiled[int(points[:, 2].argmax())] = np.nan
    return spoiled, faces


def _hole(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    top = np.argsort(points[faces].mean(axis=1)[:, 2])[-4:]
    return points, np.delete(faces, top, axis=0)


def _twice(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points, np.concatenate([faces, faces[5:9, [1, 2, 0]]])


def _flat(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = faces[10, 0], faces[10, 1]
    return points, np.concatenate([faces, [[a, b, b]]])


def _fin(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    top = int(points[faces].mean(axis=1)[:, 2].argmax())
    tip = points[faces[top]].mean(axis=0) + [0, 0, 1.5]
    fin = [faces[top, 0], faces[top, 1], len(points)]
    return np.concatenate([points, [tip]]), np.concatenate([faces, [fin]])


def _debris(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tet = 0.2 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + [20, 0, 0]
    own = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]) + len(points)
    return np.concatenate([points, tet]), np.concatenate([faces, own])


def _inward(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points, faces[:, ::-1]


def _some_turned(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mixed = faces.copy()
    mixed[::7] = mixed[::7, ::-1]
    return points, mixed


def _pierced(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spoiled = points.copy()
    spoiled[int(points[:, 2].argmax()), 2] -= 2.6
    return spoiled, faces


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_loose, "merged .* vertices of the same place"),
        (_nan, "cut out 6 triangles with NaN"),
        (_hole, "closed holes of 8 edges with 4 triangles"),
        (_twice, "cut out 4 duplicate triangles"),
        (_flat, "cut out 1 triangles without area"),
        (_fin, "took apart .* edges"),
        (_debris, "cut out 1 loose pieces of 4 triangles"),
        (_inward, "faces outward"),
        (_some_turned, "turned .* triangles"),
        (_pierced, "triangles that pass through others"),
    ],
)
def test_planted_defects_are_repaired_and_told(
    clean: tuple[np.ndarray, np.ndarray], spoil: Defect, told: str
) -> None:
    found = repair_surface(*spoil(*clean))
    assert any(re.search(told, action) for action in found.actions), found.actions
    check_closed(found.triangles, "it")
    assert not self_intersections(found.vertices, found.triangles).any()
    assert volume(found.vertices, found.triangles) == pytest.approx(volume(*clean), rel=0.03)


def test_fine_features_survive_welding(clean: tuple[np.ndarray, np.ndarray]) -> None:
    points, faces = clean
    # A dent of a hundredth of a millimetre across two close vertices stays.
    shifted = points.copy()
    shifted[0] += 0.01
    found = repair_surface(shifted, faces)
    assert found.actions == ()
    assert np.abs(found.vertices - shifted).max() < 1e-9


def _sheet(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points * [1, 1, 1e-4], faces


def _two_bodies(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([points, points + 30]), np.concatenate([faces, faces + len(points)])


def _half(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points, faces[points[faces].mean(axis=1)[:, 0] < 0]


def _crossed(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    # Everything beyond a plane mirrored back through the body.
    folded = points.copy()
    folded[:, 0] = np.where(points[:, 0] > 0, -0.7 * points[:, 0], points[:, 0])
    return folded, faces


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (_sheet, "thick at x"),
        (_two_bodies, "2 separate pieces"),
        (_half, "open edges are left, at holes of more than 12 edges"),
        (_crossed, "passes through itself in .* triangles around x"),
    ],
)
def test_what_cannot_be_repaired_is_refused(
    clean: tuple[np.ndarray, np.ndarray], spoil: Defect, told: str
) -> None:
    with pytest.raises(InputError, match=told):
        repair_surface(*spoil(*clean), max_hole_edges=12)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [(CUBE * np.nan, FACES), (CUBE, FACES + 5), (CUBE, FACES[:0]), (CUBE * 0, FACES)],
)
def test_unusable_arrays_are_refused(vertices: np.ndarray, faces: np.ndarray) -> None:
    pytest.importorskip("pymeshlab")
    with pytest.raises(InputError):
        repair_surface(vertices, faces)
