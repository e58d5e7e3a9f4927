# SPDX-License-Identifier: Apache-2.0
"""Repair of surfaces with pymeshlab, and the answer when it is not installed."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np
import pytest

from cad.mesh.repair import repair_surface
from cad.mesh.surface import check_closed
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


def test_loose_triangles_with_a_hole_become_a_closed_cube() -> None:
    pytest.importorskip("pymeshlab")
    loose = CUBE[FACES[:-1]].reshape(-1, 3)
    triangles = np.arange(len(loose)).reshape(-1, 3)[:, ::-1]
    points, faces = repair_surface(loose, triangles)
    check_closed(faces, "it")
    corners = points[faces]
    volume = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(1)


@pytest.mark.parametrize(
    ("vertices", "faces"), [(CUBE * np.nan, FACES), (CUBE, FACES + 5), (CUBE, FACES[:0])]
)
def test_unusable_arrays_are_refused(vertices: np.ndarray, faces: np.ndarray) -> None:
    pytest.importorskip("pymeshlab")
    with pytest.raises(InputError):
        repair_surface(vertices, faces)
