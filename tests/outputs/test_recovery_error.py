# SPDX-License-Identifier: Apache-2.0
"""The estimate of Zienkiewicz and Zhu: zero where elements are exact, and of the error's size."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry import QuadraticMesh, TetMesh, quadratic_mesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs.recovery_error import relative_energy_error


def block(cells: int) -> TetMesh:
    return block_mesh((cells, cells, cells), (1e-2, 1e-2, 1e-2))


@pytest.mark.parametrize("quadratic", [False, True])
def test_uniform_strain_and_rotation_have_none(quadratic: bool) -> None:
    mesh = block(2)
    mesh = quadratic_mesh(mesh) if quadratic else mesh
    rest = mesh.nodes_m
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stretched = rest @ np.diag([1.2, 0.9, 1.05]) @ turn.T
    assert relative_energy_error(mesh, rest, stretched, 1.0, 5.0) == pytest.approx(0, abs=1e-20)
    assert relative_energy_error(mesh, rest, rest @ turn.T + 0.1, 1.0, 5.0) == 0.0
    assert relative_energy_error(mesh, rest, rest, 1.0, 5.0) == 0.0


def interpolated(mesh: TetMesh | QuadraticMesh) -> float:
    """Estimate for the interpolant of a smooth field."""
    rest = mesh.nodes_m
    k = 150.0
    moved = rest.copy()
    moved[:, 0] += 1e-6 * np.sin(k * rest[:, 2])
    return relative_energy_error(mesh, rest, moved, 1.0, 1.0)


@pytest.mark.parametrize("quadratic", [False, True])
def test_it_falls_with_the_order_of_the_elements(quadratic: bool) -> None:
    found = []
    for cells in (3, 6):
        mesh = block(cells)
        found.append(interpolated(quadratic_mesh(mesh) if quadratic else mesh))
    rate = np.log2(found[0] / found[1])
    # Energy of the error: h^2 of linear elements, h^4 of quadratic ones, or better on even meshes.
    assert rate > (3.5 if quadratic else 1.5)


def test_a_stiff_part_counts_by_its_stiffness() -> None:
    mesh = quadratic_mesh(block(3))
    rest = mesh.nodes_m
    moved = rest.copy()
    # Bent in the upper half only.
    moved[:, 0] += 1e-3 * np.maximum(rest[:, 2] - rest[:, 2].mean(), 0) ** 2 / 1e-2
    upper = rest[mesh.tets[:, :4], 2].mean(axis=1) > rest[:, 2].mean()
    soft, stiff = np.where(upper, 1.0, 1e3), np.where(upper, 1e3, 1.0)
    even = relative_energy_error(mesh, rest, moved, 1.0, 1.0)
    assert relative_energy_error(mesh, rest, moved, stiff, 1.0) != pytest.approx(even, rel=1e-3)
    assert relative_energy_error(mesh, rest, moved, soft, 1.0) > relative_energy_error(
        mesh, rest, moved, stiff, 1.0
    )
