# SPDX-License-Identifier: Apache-2.0
"""Gradient and matrix of an energy against central differences, at every coordinate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.verification.assembly import central_difference, coordinate_probe

Array = np.ndarray


def assert_derivatives(
    x: Array,
    free: Array,
    step: float,
    energy: Callable[[Array], Array],
    gradient: Callable[[Array], Array],
    matrix: Array,
    least: tuple[float, float] = (0.0, 0.0),
    within: tuple[float, float] = (1e-6, 1e-6),
) -> Array:
    """Check ``gradient`` at ``x`` [node, 3] against ``energy``, ``matrix`` against ``gradient``.

    Both take configurations [6 node, node, 3], one an environment; the matrix is that of the
    ``free`` nodes. The largest entries of gradient and matrix are above ``least``, and right to the
    parts ``within`` of them. Returns d gradient / d x of all nodes, [node, 3, free, 3].
    """
    probes = coordinate_probe(x, np.arange(len(x)), step)
    found = gradient(np.repeat(x[None], len(probes), axis=0))[0]
    slope = central_difference(energy(probes), step).reshape(-1, 3)
    assert np.abs(found).max() > least[0]
    np.testing.assert_allclose(found, slope, atol=within[0] * np.abs(found).max())
    change = central_difference(gradient(probes), step)
    change = change.reshape(len(x), 3, len(x), 3)[..., free, :]
    expected = change[free].reshape(matrix.shape)
    scale = np.abs(expected).max()
    assert scale > least[1]
    np.testing.assert_allclose(matrix, expected, atol=within[1] * scale)
    return change


def assert_momenta_are_kept(x: Array, forces: Array) -> None:
    """Forces [n, 3] at ``x`` have no resultant and no moment."""
    scale = np.abs(forces).sum()
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-13 * scale)
    moment = np.cross(x, forces).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-13 * scale * np.abs(x).max())
