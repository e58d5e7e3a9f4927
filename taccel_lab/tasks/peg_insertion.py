# SPDX-License-Identifier: Apache-2.0
"""Push a peg, held between two gels, into a hole that is not where the policy believes it.

The scene is Taccel's (``peg_scene``), with its own peg or another one. The policy is blind: the
gels close in the first step, go straight down and stay. Offset and turn of gels and peg against the
hole are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import Scene
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, contact_config
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.parameters import (
    Contact,
    LearningParameters,
    NotNegative,
    PlanarStart,
    Positive,
    TaskParameters,
)
from taccel_lab.tasks.peg_scene import (
    PegParts,
    PegPath,
    generated_gel,
    peg_parts,
    peg_scene,
    targets,
)
from taccel_lab.tasks.pegs import Hole, Peg


class PegPolicy(StrictModel):
    """Where the gels go: straight lines between."""

    peg_mm: tuple[Number, Number, Number]
    """Where the peg starts, its lower end in the middle, without an offset."""
    times_s: Annotated[tuple[NotNegative, ...], Field(min_length=2)]
    gel_mm: Annotated[tuple[tuple[Number, Number, Number], ...], Field(min_length=2)]
    """Places of the gel at positive x at these times; the other one mirrors it."""
    gripped_s: NotNegative
    """Time from which slip in the grip counts."""

    @model_validator(mode="after")
    def _check_path(self) -> Self:
        if len(self.times_s) != len(self.gel_mm):
            raise ValueError(
                f"gel_mm needs a place for each of the {len(self.times_s)} times_s, "
                f"got {len(self.gel_mm)}"
            )
        if any(b <= a for a, b in pairwise(self.times_s)):
            raise ValueError("times_s must rise")
        return self


class PegGoal(StrictModel):
    """When it is done."""

    depth_mm: Positive
    """Depth of the peg's lowest point below the rim."""


class PegParameters(TaskParameters):
    """What the files of peg insertions have in common."""

    contact: Contact
    start: PlanarStart
    """Start of gels and peg, from above the middle of the hole."""
    policy: PegPolicy
    goal: PegGoal


class PegInsertionParameters(PegParameters):
    """The file of Taccel's peg insertion."""

    kind: Literal["peg-insertion"]
    meshes: Literal["published", "generated"]
    """Meshes of Taccel's example, from the data folder, or ours of the same dimensions."""
    learning: LearningParameters
    """Actions from when the gels have closed."""

    def parts(self) -> PegParts:
        """The bodies of the scene."""
        return peg_parts(self.meshes)[0]


class PegFitParameters(PegParameters):
    """The file of an insertion of another peg between the same gels."""

    kind: Literal["peg-fit"]
    peg: Peg
    hole: Hole

    def parts(self) -> PegParts:
        """The bodies of the scene."""
        return PegParts(
            generated_gel(),
            self.peg.mesh(),
            self.hole.mesh(self.peg),
            self.peg.mass_kg,
            self.peg.friction,
            self.hole.friction,
        )


class PegInsertion(TaskEpisode):
    """Peg insertion of some seeds."""

    gel = "right"

    def __init__(
        self,
        parameters: PegInsertionParameters | PegFitParameters,
        seeds: Sequence[int],
        device: str | None = None,
    ) -> None:
        self.parameters = parameters
        parts = parameters.parts()
        policy = parameters.policy
        self._path = PegPath.of_mm(policy.peg_mm, policy.times_s, policy.gel_mm)
        starts, offset = parameters.start.draw(seeds)
        self._offset = matrix_of(offset)
        peg = matrix_of(np.array([*self._path.peg_m, 0, 0, 0, 1.0]))
        scene = peg_scene(
            parts,
            self._path,
            len(seeds),
            peg_poses=pose_of(self._offset @ peg),
            dt_s=parameters.dt_s,
        )
        self._rim = float(parts.hole.vertices_m[:, 2].max())
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(scene, 0), device)
        nan = np.full(len(seeds), np.nan)
        self._depth, self._slip = nan.copy(), nan.copy()
        self._jam = np.zeros(len(seeds))
        self._grip = np.zeros((len(seeds), 2))
        self._on_hole = np.zeros(len(seeds))
        self._gripped_at = np.full((len(seeds), 3), np.nan)

    def _targets(self, scene: Scene, step: int) -> np.ndarray:
        poses = targets(scene, step, self._path)
        poses[:, :2] = pose_of(self._offset[:, None] @ matrix_of(poses[:, :2]))
        return poses

    def control(self) -> Control:
        return Control(target_poses=self._targets(self.scene, self.taken + 1))

    def measure(self) -> None:
        run = self.running
        self._grip[run] = self.forces_on("peg", SIDES)[run]
        self._on_hole[run] = np.linalg.norm(self.force_on("peg", "hole"), axis=1)[run]
        self._jam = np.maximum(self._jam, self._on_hole)
        body = self.model.bodies[self.model.body_id("peg")]
        lowest = self.state.positions.numpy()[:, body.node_slice, 2].min(axis=1)
        self._depth[run] = (self._rim - lowest)[run]
        # In the frame of the gels, which moves with them and does not turn on the way.
        middle = self._targets(self.scene, self.taken)[:, :2, :3].mean(axis=1)
        relative = self.affine_frame()[0] - middle
        if self.taken * self.parameters.dt_s >= self.parameters.policy.gripped_s - 1e-9:
            fresh = run & np.isnan(self._slip)
            self._gripped_at[fresh] = relative[fresh]
            self._slip[run] = np.linalg.norm(relative - self._gripped_at, axis=1)[run]

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        figures = {
            "depth_mm": 1e3 * self._depth[env],
            "jam_force_n": self._jam[env],
            "slip_mm": 1e3 * self._slip[env],
        }
        if not figures["depth_mm"] >= self.parameters.goal.depth_mm:
            return f"came {figures['depth_mm']:.1f} mm deep", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        gels = {f"{side} gel": float(self._grip[0, i]) for i, side in enumerate(SIDES)}
        return gels | {"hole": float(self._on_hole[0])}
