# SPDX-License-Identifier: Apache-2.0
"""Slopes of the forces of collisions against differences of those forces, column by column."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from taccel_lab.gradients import GelMotion
from taccel_lab.ipc.potentials.contact_derivatives import (
    BEFORE,
    INSET,
    NOW,
    RANGE,
    THRESHOLD,
    ContactDerivatives,
    contact_derivatives,
)
from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.scene import Ball, Element, box_mesh
from tests.gradients.gel_scenes import TIGHT, Case, press_and_shear

Array = np.ndarray
# Soft contacts and a wide range: nodes sit deep in them, so that guards of edges and faces act.
WIDE = replace(TIGHT, dhat_m=1e-4, kappa_pa=2e4)
EDGE = Case(
    box_mesh((3e-3, 2e-3, 2e-3)), press_and_shear(1.2, 0.3, 4.0)[:, None, None], 0.5, config=WIDE
)
BALL = Case(
    Ball(2e-3),
    press_and_shear(2.0, 0.4)[:, None, None],
    0.4,
    element=Element.QUADRATIC,
    config=WIDE,
)


class LastStep:
    """The collisions where the last step of a motion ended, and their forces elsewhere."""

    def __init__(self, case: Case) -> None:
        self.motion = GelMotion(case.model(), case.config)
        record = self.motion.run(case.poses)
        assert record.causes == [None]
        self.x, self.before = record.positions[-1], record.positions[-2]
        self.poses, self.poses_before = record.poses[-1], record.poses[-2]

    def mollify(self) -> None:
        """Let pairs of edges count as nearly parallel at 30 times the angle that they do."""
        thresholds = self.motion.solver.collisions.thresholds
        values = thresholds.numpy()
        thresholds.assign(np.where(values > 0, 900 * values, values))

    def slopes(self, **changed: Array) -> ContactDerivatives:
        model, solver = self.motion.model, self.motion.solver
        assert solver.friction is not None
        given = {name: changed.get(name, value) for name, value in vars(self).items()}
        motion = step_motion(
            model,
            wp.array(given["x"], dtype=wp.vec3d),
            wp.array(given["before"], dtype=wp.vec3d),
            wp.array(given["poses"], dtype=wp.transformd),
            wp.array(given["poses_before"], dtype=wp.transformd),
        )
        return contact_derivatives(model, solver.collisions, motion, solver.friction.eps_u_m, 0)


def close(found: Array, low: ContactDerivatives, high: ContactDerivatives, step: float) -> None:
    expected = (high.forces - low.forces) / (2 * step)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.thorough(cases=("before-columns1-ball", "x-columns0-ball"))
@pytest.mark.parametrize("case", [EDGE, BALL], ids=["edge", "ball"])
@pytest.mark.parametrize(("name", "columns"), [("x", NOW), ("before", BEFORE)])
def test_by_positions(case: Case, name: str, columns: slice) -> None:
    at = LastStep(case)
    at.mollify()
    slopes = at.slopes()
    way = np.random.default_rng(0).normal(size=at.x.shape)
    step = 1e-10
    low, high = (at.slopes(**{name: getattr(at, name) + s * step * way}) for s in (-1, 1))
    of_nodes = way[0, slopes.nodes].reshape(-1, 12)
    found = np.einsum("cnix,cn->cix", slopes.columns[:, columns], of_nodes)
    close(found, low, high, step)


@pytest.mark.thorough(cases=("insets-31-case1-0",))
@pytest.mark.parametrize(
    ("name", "column", "case", "kind"),
    [
        ("thresholds", THRESHOLD, EDGE, 3),
        ("insets", INSET, BALL, 0),
        ("ranges", RANGE, EDGE, 3),
    ],
)
def test_by_the_numbers_of_a_collision(name: str, column: int, case: Case, kind: int) -> None:
    at = LastStep(case)
    at.mollify()
    slopes = at.slopes()
    collisions = at.motion.solver.collisions
    array = getattr(collisions, name)
    values = array.numpy().copy()
    assert np.abs(slopes.columns[slopes.kinds == kind, column]).max() > 0
    mine = values[: len(slopes.kinds)][slopes.kinds == kind]
    size = 1e-10 if name == "insets" else 1e-6 * mine.min()
    sides = []
    for side in (-1, 1):
        array.assign(values + side * size)
        sides.append(at.slopes())
    array.assign(values)
    close(slopes.columns[:, column], *sides, size)
