# SPDX-License-Identifier: Apache-2.0
"""One touch before and after it is simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.geometry import TetMesh
from taccel_lab.signals.perturbation import Perturbation


@dataclass(frozen=True, eq=False)
class Touch:
    """One episode, ready to be simulated."""

    episode: int
    mesh: TetMesh
    frame: np.ndarray
    """gel_from_press, [7]."""
    commands: np.ndarray
    """Columns ``motion.COMMAND``, [step, 6]."""
    friction: float
    unit: int = 0
    young_modulus_factor: float = 1.0
    light: Perturbation | None = None
    noise_levels: float = 0.0
    marker_noise_px: float = 0.0
    seed: tuple[int, ...] = (0,)
    """Seed of the noise."""

    def rng(self, step: int, what: int) -> np.random.Generator:
        """Source of the noise of one step."""
        return np.random.default_rng([*self.seed, self.episode, step, what])


@dataclass(frozen=True, eq=False)
class TouchRecord:
    """What is kept of a touch."""

    episode: int
    rows: dict[str, np.ndarray]
    """Rows by channel, [step + 1, ...]: the untouched gel, then each step that converged."""
    wanted: int
    """Steps of the motion."""
    cause: str
    """Why there are fewer; empty when all converged."""
    gel_from_press: np.ndarray
    nodes_m: np.ndarray
    """Contact face at rest, [node, 3]."""
    faces: np.ndarray
    """Its triangles, [face, 3]."""


def failed_touch(episode: int, wanted: int, cause: str) -> TouchRecord:
    """The record of a touch that could not be set up."""
    nothing = np.zeros((0, 3))
    return TouchRecord(
        episode, {}, wanted, cause, np.full(7, np.nan), nothing, nothing.astype(np.int32)
    )
