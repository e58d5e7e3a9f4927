# SPDX-License-Identifier: Apache-2.0
"""Slopes of the forces of collisions against differences of those forces, column by column."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from taccel_lab.gradients import GelMotion
from taccel_lab.ipc.potentials import contact_derivatives as derivatives
from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.scene import Ball, Element, box_mesh
from tests.gradients.gel_scenes import TIGHT, Case, press_and_shear

Array = np.ndarray
# Soft contacts and a wide range: nodes sit deep in them, so that guards of edges and faces act.
WIDE = replace(TIGHT, dhat_m=1e-4, kappa_pa=2e4)
ON_EDGE = press_and_shear(1.2, 0.3, 4.0)[:, None, None]
EDGE = Case(box_mesh((3e-3, 2e-3, 2e-3)), ON_EDGE, 0.5, config=WIDE)
ON_BALL = press_and_shear(2.0, 0.4)[:, None, None]
BALL = Case(Ball(2e-3), ON_BALL, 0.4, element=Element.QUADRATIC, config=WIDE)


class LastStep:
    """Where the last step of a motion ended; more pairs of edges count as nearly parallel."""

    def __init__(self, case: Case) -> None:
        motion = GelMotion(case.model(), case.config)
        record = motion.run(case.poses)
        assert record.causes == [None]
        self.solver = motion.solver
        self.x, self.before = record.positions[-1], record.positions[-2]
        self.poses = [wp.array(p, dtype=wp.transformd) for p in record.poses[-1:-3:-1]]
        thresholds = self.solver.collisions.thresholds
        values = thresholds.numpy()
        thresholds.assign(np.where(values > 0, 900 * values, values))

    def slopes(self, **moved: Array) -> derivatives.ContactDerivatives:
        """With the nodes ``x`` of now or those ``before`` elsewhere."""
        solver = self.solver
        assert solver.friction is not None
        places = ({"x": self.x, "before": self.before} | moved).values()
        nodes = (wp.array(place, dtype=wp.vec3d) for place in places)
        motion, eps = step_motion(solver.model, *nodes, *self.poses), solver.friction.eps_u_m
        return derivatives.contact_derivatives(solver.model, solver.collisions, motion, eps, 0)


def close(found: Array, low, high, step: float) -> None:
    expected = (high.forces - low.forces) / (2 * step)
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(found, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.thorough(cases=("before-columns1-ball", "x-columns0-ball"))
@pytest.mark.parametrize("case", [EDGE, BALL], ids=["edge", "ball"])
@pytest.mark.parametrize(
    ("name", "columns"), [("x", derivatives.NOW), ("before", derivatives.BEFORE)]
)
def test_by_positions(case: Case, name: str, columns: slice) -> None:
    at, step = LastStep(case), 1e-10
    slopes = at.slopes()
    way = np.random.default_rng(0).normal(size=at.x.shape)
    low, high = (at.slopes(**{name: getattr(at, name) + s * step * way}) for s in (-1, 1))
    of_nodes = way[0, slopes.nodes].reshape(-1, 12)
    close(np.einsum("cnix,cn->cix", slopes.columns[:, columns], of_nodes), low, high, step)


@pytest.mark.thorough(cases=("insets-31-case1-0",))
@pytest.mark.parametrize(
    ("name", "column", "case", "kind"),
    [
        ("thresholds", derivatives.THRESHOLD, EDGE, 3),
        ("insets", derivatives.INSET, BALL, 0),
        ("ranges", derivatives.RANGE, EDGE, 3),
    ],
)
def test_by_the_numbers_of_a_collision(name: str, column: int, case: Case, kind: int) -> None:
    at = LastStep(case)
    slopes, array = at.slopes(), getattr(at.solver.collisions, name)
    mine, values = slopes.kinds == kind, array.numpy().copy()
    assert np.abs(slopes.columns[mine, column]).max() > 0
    size = 1e-10 if name == "insets" else 1e-6 * values[: len(mine)][mine].min()
    sides = []
    for side in (-1, 1):
        array.assign(values + side * size)
        sides.append(at.slopes())
    close(slopes.columns[:, column], *sides, size)
