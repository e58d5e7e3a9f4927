# SPDX-License-Identifier: Apache-2.0
"""Presses of gels of 1 MPa, each kept in the cache by all that its forces depend on.

They are taken one by one. Those of a table as environments of one scene gained 3 s of 7 on an H200
(docs/evidence/ablations.md) and nothing on a core.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taccel_lab.calibration.material.gel import CurveTool, Gel
from taccel_lab.files.file_cache import cached_arrays
from taccel_lab.geometry import TetMesh
from taccel_lab.presses import PressEnv, PressPath, profile_material

RUBBING_LIMITS = {"max_substep_halvings": 3, "max_friction_lags": 60}
"""Of iterations, on which no result depends: with much friction a step that does not converge soon
will not."""
RECIPE_VERSION = 3
"""Raised when the solver or the way of simulating changes forces, so that none are taken from the
cache that were made otherwise."""


@dataclass(frozen=True)
class GelBench:
    """A gel and a tool, on the mesh of one depth."""

    gel: Gel
    tool: CurveTool
    depth_mm: float

    @cached_property
    def mesh(self) -> TetMesh:
        return self.gel.mesh(self.tool, self.depth_mm)

    def pressed(self, gel: Gel, friction: float = 0.0) -> dict[str, np.ndarray]:
        """``force_n`` of a press of ``gel`` to the depth of the bench, and its ``seconds``.

        ``gel`` differs from that of the bench in its law at most.

        Raises:
            SimulationError: It did not converge.
        """

        def made() -> dict[str, np.ndarray]:
            env = self._env(gel, friction)
            seconds = sum(report.seconds for report in env.follow(PressPath(self.depth_mm)))
            return {"force_n": env.press_force[:, 2], "seconds": np.array(seconds)}

        return cached_arrays("responses", self._recipe(gel, friction)).read_or_make(made)

    def _recipe(self, gel: Gel, friction: float) -> dict[str, Any]:
        """All that a press of ``gel`` here depends on."""
        return {
            "version": RECIPE_VERSION,
            "gel": gel.recipe(),
            "tool": self.tool.description,
            "at_mm": list(self.tool.at_mm),
            "nu": gel.material.poisson_ratio,
            "ratio": gel.material.mooney_ratio,
            "physics": gel.physics.record(),
            "depth_mm": self.depth_mm,
            "friction": friction,
        }

    def _env(self, gel: Gel, friction: float) -> PressEnv:
        """A gel of 1 MPa at rest."""
        return PressEnv(
            self.mesh,
            profile_material(gel.unit_material(), self.mesh),
            self.tool.indenter(),
            np.array([self.tool.at_mm]),
            friction_coefficient=friction,
            physics=self.gel.physics,
            config=self.gel.physics.solver(**(RUBBING_LIMITS if friction else {})),
            device=self.gel.device,
        )
