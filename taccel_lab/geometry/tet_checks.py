# SPDX-License-Identifier: Apache-2.0
"""How tets and surface hang together: what no mesh may get wrong, whatever it is for."""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry.tet_mesh import TetMesh

_NAMED = 5
"""How many offenders a message lists."""


def first_of(items: np.ndarray) -> str:
    """The first few ids or tuples of ids, for a message."""
    text = ", ".join(
        str(tuple(item.tolist())) if np.ndim(item) else str(int(item)) for item in items[:_NAMED]
    )
    return text + (", ..." if len(items) > _NAMED else "")


def refuse_any(found: np.ndarray, what: str, said: str, named: str, hint: str = "") -> None:
    """Refuse a mesh in which anything was ``found``: InputError with ``what`` it is, how many,
    what is ``said`` of them, the first of them as they are ``named``, and a ``hint``."""
    if len(found):
        raise InputError(f"{what}: {len(found)} {said}: {named} {first_of(found)}{hint}")


def check_connectivity(mesh: TetMesh, what: str) -> None:
    """Refuse nodes of no tet, tets that share a face with several or lie on the same side of it,
    and surfaces that are not just the outward faces of exactly one tet, each once."""
    tets = mesh.tets.astype(np.int64)
    unused = np.setdiff1d(np.arange(len(mesh.nodes_m)), tets)
    hint = "; such nodes have neither mass nor stiffness and must be removed"
    refuse_any(unused, what, "nodes belong to no tet", "nodes", hint)
    outward = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    keys, inverse, uses = unique_rows(np.sort(outward, axis=1))
    owner = np.arange(len(outward)) // 4
    crowded = np.flatnonzero(uses > 2)
    if len(crowded):
        where = owner[np.isin(inverse, crowded)]
        raise InputError(
            f"{what}: {len(crowded)} faces are shared by more than two tets: tets {first_of(where)}"
        )
    turn = np.bincount(inverse, _parity(outward), minlength=len(keys))
    folded = np.flatnonzero((uses == 2) & (turn != 0))
    if len(folded):
        where = owner[np.isin(inverse, folded)]
        raise InputError(
            f"{what}: {len(folded)} pairs of tets lie on the same side of the face they share, "
            f"so they overlap: tets {first_of(where)}"
        )
    expected = _rotated(outward[uses[inverse] == 1])
    known = unique_rows(expected)[0]
    given = unique_rows(_rotated(mesh.faces.astype(np.int64)))[0]
    foreign = len(unique_rows(np.concatenate([known, given]))[0]) - len(known)
    repeated = len(mesh.faces) - len(given)
    if foreign or repeated or len(given) != len(known):
        raise InputError(
            f"{what}: TetMesh.faces has {len(mesh.faces)} faces, of which {foreign} are not "
            f"outward faces of exactly one tet and {repeated} are repeated; the surface consists "
            f"of {len(known)} such faces (see geometry.tet_mesh.boundary_faces)"
        )


def _rotated(faces: np.ndarray) -> np.ndarray:
    """The same faces with the smallest id first."""
    first = faces.argmin(axis=1)[:, None]
    return np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)


def _parity(faces: np.ndarray) -> np.ndarray:
    """+1 for faces whose corners ascend up to a rotation, else -1."""
    a, b, c = faces.T
    return np.where((a < b).astype(int) + (b < c) + (c < a) == 2, 1, -1)


def unique_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unique rows of ids, the place of each row among them, and how often each occurs."""
    base = rows.max() + 1
    if base ** rows.shape[1] >= 2**62:
        unique, inverse, counts = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
        return unique, inverse.ravel(), counts
    # As one 64-bit key rows sort many times faster.
    key = rows[:, 0]
    for column in range(1, rows.shape[1]):
        key = key * base + rows[:, column]
    _, first, inverse, counts = np.unique(
        key, return_index=True, return_inverse=True, return_counts=True
    )
    return rows[first], inverse.ravel(), counts
