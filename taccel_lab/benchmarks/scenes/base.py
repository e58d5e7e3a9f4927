# SPDX-License-Identifier: Apache-2.0
"""What a benchmark scene is: bodies, settings and a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.scene import Scene
from taccel_lab.solvers import SolverConfig

RESIDUAL_RATIO, RESIDUAL_N = 1e-4, 1e-5
"""A step counts as converged when the force residual is at most the first times the contact force,
or the second [N]; speeds are quoted at that."""


@dataclass(frozen=True)
class SceneOptions:
    """What a user may choose of any scene."""

    env_count: int = 1
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Fields of ``SolverConfig`` other than the scene's."""
    lag: int = 0
    """Environment e is e modulo (lag + 1) steps behind: environments that differ, as in use."""


@dataclass(frozen=True)
class BenchScene:
    """A scene and its motion."""

    name: str
    what: str
    """One line for a table."""
    scene: Scene
    config: SolverConfig
    path: np.ndarray
    """Poses of the kinematic bodies, [steps + 1, kinematic_count, 7]: at the start, and the target
    of each step."""
    source: str
    """published or generated: where the meshes are from."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the arrangement that go into results."""
    lag: int = 0
    """See ``SceneOptions``."""

    def __post_init__(self) -> None:
        expected = (len(self.scene.kinematic_bodies), 7)
        if self.path.ndim != 3 or self.path.shape[1:] != expected:
            raise InputError(
                f"path of {self.name!r} has shape {self.path.shape}, expected [steps + 1, "
                f"{expected[0]}, 7]"
            )

    @property
    def steps(self) -> int:
        """Steps of the whole motion."""
        return len(self.path) - 1

    def targets(self, step: int) -> np.ndarray:
        """Poses at the end of a step (1, 2, ...; 0 is the start), [env, kinematic, 7]."""
        behind = np.arange(self.scene.env_count) % (self.lag + 1)
        return self.path[np.maximum(step - behind, 0)]


def make_config(defaults: Mapping[str, Any], chosen: Mapping[str, Any]) -> SolverConfig:
    """Settings of a scene, with what was chosen in their place."""
    try:
        return SolverConfig(**{"absolute_tolerance_n": RESIDUAL_N, **defaults, **chosen})
    except TypeError as error:
        raise InputError(f"no such setting of the solver: {error}") from None


def straight(points: np.ndarray, counts: list[int]) -> np.ndarray:
    """Poses along straight lines between key poses [k, ..., 7], ``counts`` steps for each line.

    Positions go evenly, quaternions by normalised linear interpolation (key poses are near each
    other or have the same turn). Shape [sum(counts) + 1, ..., 7].
    """
    rows = [points[:1]]
    for first, last, count in zip(points, points[1:], counts, strict=False):
        parts = (np.arange(count) + 1) / count
        parts = parts.reshape(-1, *[1] * (points.ndim - 1))
        rows.append(first + parts * (last - first))
    path = np.concatenate(rows)
    path[..., 3:] /= np.linalg.norm(path[..., 3:], axis=-1, keepdims=True)
    return path
