# SPDX-License-Identifier: Apache-2.0
"""``TaskEpisode``: seeds of a task as environments of one solver, from start to judgement."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from taccel_lab.outputs import Outputs
from taccel_lab.scene import Scene
from taccel_lab.solvers import Control, EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from taccel_lab.tasks.parameters import TaskParameters
from taccel_lab.tasks.result import TaskTrial


class TaskEpisode(ABC):
    """One solver, an environment a seed. Environments that fail stay where they are and are judged
    as failures with their ``EnvStatus`` as cause; the others go on."""

    gel = ""
    """Name of the soft body that recordings show."""

    def __init__(
        self,
        parameters: TaskParameters,
        seeds: Sequence[int],
        starts: Sequence[dict[str, float]],
        scene: Scene,
        config: SolverConfig,
        poses: np.ndarray,
        device: str | None,
    ) -> None:
        """
        Args:
            parameters: Of the task.
            seeds: One for each environment.
            starts: What each seed drew.
            scene: With as many environments.
            config: Of the solver.
            poses: Of the kinematic bodies at the start, [env, body, 7].
            device: As of ``Scene.finalize``.
        """
        self.seeds, self.starts, self.scene = list(seeds), list(starts), scene
        self.step_limit = parameters.steps
        self.model = scene.finalize(device)
        self.solver = SolverIPC(self.model, config)
        self.state = initial_state(self.model, poses)
        self.outputs = Outputs(self.solver)
        self.running = np.ones(len(self.seeds), dtype=bool)
        """Environments that have not failed, bool, [env]."""
        self.taken = 0
        """Steps so far."""
        self._steps = np.zeros(len(self.seeds), dtype=int)
        self._causes = [""] * len(self.seeds)

    @abstractmethod
    def control(self) -> Control:
        """What the policy asks of the next step."""

    @abstractmethod
    def measure(self) -> None:
        """Look at the step that was taken, in the environments that are running."""

    @abstractmethod
    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        """Why an environment does not meet the criterion, empty if it does; and its figures."""

    def cell(self, env: int) -> tuple[str, ...]:
        """What an environment is of, of tasks with several cells: their results are listed
        apart."""
        return ()

    @classmethod
    def groups(cls, parameters: TaskParameters, seeds: Sequence[int]) -> list[Sequence[int]]:
        """Seeds that become environments of one solver, group by group."""
        size = parameters.environments
        return [seeds[i : i + size] for i in range(0, len(seeds), size)]

    @abstractmethod
    def forces(self) -> dict[str, float]:
        """Forces of environment 0 that recordings show, by name [N]."""

    @property
    def over(self) -> bool:
        """Whether there is nothing more to step."""
        return self.taken >= self.step_limit or not self.running.any()

    def outcome(self) -> str:
        """How environment 0 is judged now, in words."""
        trial = self.trials()[0]
        return f"failure: {trial.cause}" if trial.cause else "success"

    def advance(self) -> None:
        """Take a step in the environments that are running."""
        report = self.solver.step(self.state, self.control(), who=self.running)
        self.taken += 1
        for env in np.flatnonzero(self.running & ~report.converged):
            status = EnvStatus(int(report.status[env])).name
            self._causes[env] = f"solver: {status} in step {self.taken}"
        self.running &= report.converged
        self._steps += self.running
        self.outputs.update(self.state)
        self.measure()

    def trials(self) -> list[TaskTrial]:
        """What came of each seed."""
        found = []
        for env, (seed, start) in enumerate(zip(self.seeds, self.starts, strict=True)):
            missed, measured = self.judge(env)
            figures = {name: float(value) for name, value in measured.items()}
            cause = self._causes[env] or missed
            steps = int(self._steps[env])
            found.append(
                TaskTrial(seed, not cause, cause, steps, start, figures, cell=self.cell(env))
            )
        return found

    @classmethod
    def conclude(
        cls, parameters: TaskParameters, trials: list[TaskTrial], device: str | None
    ) -> list[TaskTrial]:
        """Trials of all seeds of a run, judged together where a task does so."""
        return trials

    def force_on(self, body: str, other: str, friction: bool = True) -> np.ndarray:
        """Force of contact, and of friction, on a body by another one [N], [env, 3]."""
        i, j = self.model.body_id(body), self.model.body_id(other)
        force = self.outputs.contact_wrenches().wrenches.numpy()[:, i, j, :3]
        if friction:
            force = force + self.outputs.friction_wrenches().wrenches.numpy()[:, i, j, :3]
        return force

    def forces_on(self, body: str, others: Sequence[str], friction: bool = True) -> np.ndarray:
        """How hard each of several bodies pushes on a body [N], [env, other]."""
        forces = [self.force_on(body, other, friction) for other in others]
        return np.linalg.norm(np.stack(forces, axis=1), axis=2)

    def affine_frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Centre of mass [m], [env, 3], of the first affine body, and its principal axes times a
        length in columns, [env, 3, 3]: unchanged in shape, they tell how it has turned."""
        first = self.model.affine.first_control
        rows = self.state.positions.numpy()[:, first : first + 4].copy()
        return rows[:, 0], np.swapaxes(rows[:, 1:], 1, 2)
