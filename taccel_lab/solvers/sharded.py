# SPDX-License-Identifier: Apache-2.0
"""``ShardedSolver``: the environments of a scene spread over several devices of this process.

Environments do not influence one another: each device has a model, a solver and a state of its own,
and nothing passes between devices. For one process a device see ``scene.shards.shard_of``.

There is a thread for each device; they take turns (``model.turns``) in launching, and wait side by
side. What a step asks of the host between two waits is short.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.model import Model
from taccel_lab.model.devices import require_device
from taccel_lab.scene.scene import Scene
from taccel_lab.scene.shards import shard_of, shard_slice
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import StepReport
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State, as_poses, initial_state

T = TypeVar("T")


@dataclass(frozen=True)
class Shard:
    """What one device has."""

    environments: slice
    """Its environments, in numbers of the whole scene."""
    solver: SolverIPC
    state: State

    @property
    def model(self) -> Model:
        """Of these environments alone, which count from 0 here."""
        return self.solver.model


class ShardedSolver:
    """Steps a scene whose environments are spread over devices; the results are those of one.

    On the CPU the shards are stepped one after the other.
    """

    def __init__(
        self,
        scene: Scene,
        devices: Sequence[str],
        config: SolverConfig | None = None,
        poses: np.ndarray | None = None,
    ) -> None:
        """``devices``: "cuda:0", "cuda:1", ..., as many as there are shards; their sizes differ by
        one environment at most. ``poses``: of the kinematic bodies at the start,
        [env_count, kinematic_count, 7]; at the origin when None.
        """
        self.scene = scene
        names = _checked_devices(devices, scene.env_count)
        slices = [shard_slice(scene.env_count, i, len(names)) for i in range(len(names))]
        if poses is not None:
            _check_shape(scene, poses)
        self.shards: list[Shard] = []
        for rank, (name, part) in enumerate(zip(names, slices, strict=True)):
            model = shard_of(scene, rank, len(names)).finalize(name)
            start = None if poses is None else np.asarray(poses)[part]
            solver = SolverIPC(model, config)
            self.shards.append(Shard(part, solver, initial_state(model, start)))
        self._threads = ThreadPoolExecutor(len(names), thread_name_prefix="shard")

    @property
    def env_count(self) -> int:
        """Environments of all shards."""
        return self.scene.env_count

    @property
    def states(self) -> list[State]:
        """The state of each shard."""
        return [shard.state for shard in self.shards]

    def step(self, target_poses: np.ndarray | None = None) -> StepReport:
        """Advance all environments by dt, as ``SolverIPC.step`` does; one report for all.

        ``target_poses``: [env_count, kinematic_count, 7]; kinematic bodies stay where they are when
        None. Nothing is stepped when they are wrong anywhere.
        """
        started = time.perf_counter()
        targets = self._cut_poses(target_poses)
        reports = self._everywhere(
            lambda shard, target: shard.solver.step(shard.state, target), targets
        )
        return _joined(reports, time.perf_counter() - started)

    def reset(self, mask: np.ndarray, poses: np.ndarray | None = None) -> None:
        """Put the environments of ``mask`` (bool, [env_count]) back to their initial state; see
        ``SolverIPC.reset``."""
        mask = np.asarray(mask)
        if mask.shape != (self.env_count,) or mask.dtype != bool:
            raise InputError(
                f"mask must be bool of shape [{self.env_count}], got {mask.dtype} of shape "
                f"{list(mask.shape)}"
            )
        starts = self._cut_poses(poses)
        for shard, start in zip(self.shards, starts, strict=True):
            mine = mask[shard.environments]
            if mine.any():
                shard.solver.reset(shard.state, mine, start)

    def gather(self, read: Callable[[Shard], wp.array | np.ndarray]) -> np.ndarray:
        """Arrays of all shards, joined on the host along their first axis, the environment.

        For instance the barrier's forces on nodes [N], [env_count, node_count, 3]:
        ``-solver.gather(lambda shard: shard.solver.contact_gradient)``.
        """
        parts: list[Any] = [read(shard) for shard in self.shards]
        return np.concatenate([p.numpy() if isinstance(p, wp.array) else p for p in parts])

    def positions(self) -> np.ndarray:
        """Node positions [m], float64, shape [env_count, node_count, 3], on the host."""
        return self.gather(lambda shard: shard.state.positions)

    def _cut_poses(self, poses: np.ndarray | None) -> list[np.ndarray | None]:
        """Poses of each shard, all of them checked."""
        if poses is None:
            return [None] * len(self.shards)
        value = _check_shape(self.scene, poses)
        return [as_poses(shard.model, value[shard.environments]) for shard in self.shards]

    def _everywhere(
        self, work: Callable[[Shard, np.ndarray | None], T], values: list[np.ndarray | None]
    ) -> list[T]:
        """Run ``work`` for each shard, in turns; all have ended when an error is raised."""
        pairs = zip(self.shards, values, strict=True)
        running = [self._threads.submit(work, *pair) for pair in pairs]
        wait(running)
        return [one.result() for one in running]


def _checked_devices(devices: Sequence[str], env_count: int) -> list[str]:
    """The devices, of which there must be one, and no more than environments."""
    names = [devices] if isinstance(devices, str) else list(devices)
    for name in names:
        require_device(name)
    if not 1 <= len(names) <= env_count:
        raise InputError(
            f"{env_count} environments can be spread over 1 to {env_count} devices, "
            f"got {len(names)}: {', '.join(names) or 'none'}"
        )
    return names


def _check_shape(scene: Scene, poses: np.ndarray) -> np.ndarray:
    value = np.asarray(poses, dtype=np.float64)
    expected = (scene.env_count, len(scene.kinematic_bodies), 7)
    if value.shape != expected:
        raise InputError(f"poses have shape {value.shape}, expected {expected}")
    return value


def _joined(reports: Sequence[StepReport], seconds: float) -> StepReport:
    """One report of all environments."""
    names = [field.name for field in fields(StepReport) if field.name != "seconds"]
    arrays = {name: np.concatenate([getattr(r, name) for r in reports]) for name in names}
    return StepReport(**arrays, seconds=seconds)
