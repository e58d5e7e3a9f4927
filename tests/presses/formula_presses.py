# SPDX-License-Identifier: Apache-2.0
"""Presses whose force is off by a formula of mesh, contact range and steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from taccel_lab.errors import SimulationError
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    PressOutcome,
    PressPath,
    PressSetup,
    PressStep,
    parse_indenter,
)
from taccel_lab.presses.numerical_error import (
    MOST_LEVELS,
    MeasuredPress,
    Resolution,
    measured_press,
)
from taccel_lab.scene import Ball, Material, TriangleMesh
from taccel_lab.solvers import StepReport

GEL, BALL = Material(1e5, 0.45), parse_indenter("sphere:4")
DEFAULT = PHYSICS[Accuracy.DEFAULT]
DEPTH_M = 5e-4
TRUE_N = 2.0


def outcome(
    at: Resolution, force_n: float, guard_share: float = 0.0, steps_share: float | None = None
) -> PressOutcome:
    """A press whose heights are as far off as its force."""
    wrench = np.array([0.0, 0.0, force_n, 0.0, 0.0, 0.0])
    path = PressPath(1e3 * DEPTH_M).with_steps(at.steps)
    flat, off = np.zeros((4, 5)), force_n / TRUE_N - 1
    normals = np.broadcast_to([0.0, 0.0, 1.0], (4, 5, 3))
    report = StepReport.__new__(StepReport)
    return PressOutcome(
        mesh=None,  # type: ignore[arg-type]
        setup=PressSetup(None, GEL, BALL, physics=DEFAULT),  # type: ignore[arg-type]
        path=path,
        steps=[PressStep(path.depth_mm, (0.0, 0.0), 0.0, wrench, report)],
        force_error_n=np.nan,
        height_error_m=np.nan,
        positions_m=flat[:, :3],
        contact_forces_n=flat[:, :3],
        contact_pressures_pa=flat,
        von_mises_pa=flat,
        indenter_pose=np.zeros(7),
        setback_m=0.0,
        height_m=flat - DEPTH_M * (1 - 0.3 * off),
        rest_height_m=flat,
        normals=normals,
        rest_normals=normals,
        contact_mask=flat > 0,
        contact_radius_m=1e-3,
        smallest_volume_ratio=1.0,
        guard_share=guard_share,
        steps_share=steps_share,
    )


@dataclass
class Presses:
    """Presses whose force is off by ``mesh`` h^order, ``dhat`` dhat and ``path`` over the steps."""

    mesh: float
    dhat: float = 0.0
    path: float = 0.0
    order: float = 2.0
    guard_share: float = 0.0
    fails: Callable[[Resolution], bool] = lambda at: False
    done: list[Resolution] = field(default_factory=list)

    def off(self, at: Resolution) -> float:
        return self.mesh / at.mesh**self.order + self.dhat * at.dhat + self.path / at.steps

    def __call__(self, at: Resolution) -> PressOutcome:
        self.done.append(at)
        if self.fails(at):
            raise SimulationError("the gel folded")
        fewer = replace(at, steps=0.5 * at.steps)
        off = self.off(at)
        share = (1 + self.off(fewer)) / (1 + off) - 1 if off != -1 else 0.0
        return outcome(at, TRUE_N * (1 + off), self.guard_share, share)

    def measured(
        self, shape: Ball | TriangleMesh, asked: float | None = None, **options: Any
    ) -> MeasuredPress:
        options = {"remembers": True, "friction": 0.0, "levels": MOST_LEVELS, **options}
        return measured_press(self, DEFAULT, shape, asked=asked, **options)


def stated(found: MeasuredPress) -> PressOutcome:
    return found.error.stated_for(found.outcome)
