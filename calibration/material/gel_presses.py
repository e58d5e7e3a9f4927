# SPDX-License-Identifier: Apache-2.0
"""Presses of gels of 1 MPa, each kept in the cache by all that its forces depend on.

They are taken one by one. Those of a table as environments of one scene gained 3 s of 7 on an H200
(docs/ablations.md) and nothing on a core.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from taccel_lab.calibration.material.gel import CurveTool, Gel
from taccel_lab.errors import SimulationError
from taccel_lab.files.file_cache import cached_arrays
from taccel_lab.geometry import TetMesh
from taccel_lab.presses import PressEnv, PressPath, profile_material

RUBBING_LIMITS = {"max_substep_halvings": 3, "max_friction_lags": 60}
"""Of iterations, on which no result depends: with much friction a step that does not converge soon
will not."""
RECIPE_VERSION = 3
"""Raised when the solver or the way of simulating changes forces, so that none are taken from the
cache that were made otherwise."""
PRESS_STEPS, LARGEST_STEP_MM = 4, 0.2
"""Steps down before a slide, and the longest of the slide."""


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
            stops = [depth for depth, _, _ in PressPath(self.depth_mm).waypoints()]
            seconds = sum(env.move_to(depth).seconds for depth in stops)
            return {"force_n": env.press_force[:, 2], "seconds": np.array(seconds)}

        motion = {"depth_mm": self.depth_mm, "friction": friction}
        return cached_arrays("responses", self._recipe("press", gel, motion)).read_or_make(made)

    def slid(self, travel_mm: np.ndarray, friction: float) -> float:
        """Tangential over normal force of the bench's gel at the end of a drag along x.

        The tangential force is the resistance less that before the drag. NaN where it does not
        converge: with much friction the gel folds up behind the tool.

        Args:
            travel_mm: Where the drag is refined to steps of at most 0.2 mm, rising from 0, [stop].
            friction: Coefficient.

        Raises:
            SimulationError: The press before the drag did not converge.
        """

        def made() -> dict[str, np.ndarray]:
            env, depth = self._env(self.gel, friction), self.depth_mm
            for step in range(PRESS_STEPS):
                env.move_to(depth * (step + 1) / PRESS_STEPS)
            start_n = env.press_force[0, 0]
            try:
                for before, value in pairwise(travel_mm.tolist()):
                    count = math.ceil((value - before) / LARGEST_STEP_MM)
                    for shift in np.linspace(before, value, count + 1)[1:].tolist():
                        env.move_to(depth, (shift, 0.0))
            except SimulationError:
                return {"ratio": np.array(np.nan)}
            along, _, normal = env.press_force[0]
            return {"ratio": np.array((start_n - along) / normal)}

        motion = {"depth_mm": self.depth_mm, "travel_mm": travel_mm, "friction": friction}
        kept = cached_arrays("responses", self._recipe("slide", self.gel, motion))
        return float(kept.read_or_make(made)["ratio"])

    def _recipe(self, what: str, gel: Gel, motion: Mapping[str, Any]) -> dict[str, Any]:
        """All that a press of ``gel`` here depends on."""
        return {
            "version": RECIPE_VERSION,
            "what": what,
            "gel": gel.recipe(),
            "tool": self.tool.description,
            "at_mm": list(self.tool.at_mm),
            "nu": gel.material.poisson_ratio,
            "ratio": gel.material.mooney_ratio,
            "physics": gel.physics.record(),
            **motion,
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
