# SPDX-License-Identifier: Apache-2.0
"""Presses that a table asks for, planned first and simulated alone or many in one scene.

Each is kept on disk for itself. A GPU takes those that are missing together, as environments of one
scene, and what does not converge there is tried again alone; one core is quicker with one at a time
(docs/calibration_material.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.material.gel_presses import GelPresses, Stop
from taccel_lab.errors import SimulationError
from taccel_lab.files.file_cache import CachedFile, cached_arrays
from taccel_lab.presses import profile_material
from taccel_lab.progress import Progress, silent

if TYPE_CHECKING:
    # Machines that only simulate have no reader of profiles.
    from taccel_lab.calibration.material.gel import CurveTool, Gel
    from taccel_lab.geometry import TetMesh

RUBBING_LIMITS = {"max_substep_halvings": 3, "max_friction_lags": 60}
"""Of iterations, on which no result depends."""
RECIPE_VERSION = 2
"""Raised when the solver or the way of simulating changes forces, so that none are taken from the
cache that were made otherwise."""
CPU_BATCH, GPU_BATCH = 1, 128
"""Environments a scene."""


@dataclass(frozen=True)
class CurvePlan:
    """One gel and the way of the tool on it."""

    recipe: Mapping[str, Any]
    """All that its forces depend on, the key in the cache."""
    poisson_ratio: float
    mooney_ratio: float
    friction: float
    stops: Sequence[Stop]
    read: Callable[[GelPresses, Sequence[CurvePlan]], np.ndarray]
    """What a scene shows where its tools are, shape [env, ...], given the plans of its
    environments."""
    arrays: Callable[[np.ndarray], dict[str, np.ndarray]]
    """What is kept, from what was read, shape [stop that is read, ...], NaN where not reached."""
    must_reach: int = 0
    """How many of the stops that are read have to be reached; beyond them, what was not reached is
    NaN."""

    @property
    def kept(self) -> CachedFile[dict[str, np.ndarray]]:
        """The file of its arrays in the cache."""
        return cached_arrays("responses", self.recipe)


@dataclass(frozen=True)
class GelBench:
    """A gel and a tool, on the mesh of one depth."""

    gel: Gel
    tool: CurveTool
    depth_mm: float

    @property
    def device(self) -> str:
        return self.gel.device

    @cached_property
    def mesh(self) -> TetMesh:
        return self.gel.mesh(self.tool, self.depth_mm)

    def plan(
        self,
        what: str,
        gel: Gel,
        friction: float,
        motion: Mapping[str, Any],
        stops: Sequence[Stop],
        read: Callable[[GelPresses, Sequence[CurvePlan]], np.ndarray],
        arrays: Callable[[np.ndarray], dict[str, np.ndarray]],
        must_reach: int = 0,
    ) -> CurvePlan:
        """A press of ``gel``, which differs from that of the bench in its law at most; its key is
        made of gel, tool, physics and the ``motion`` of the tool."""
        return CurvePlan(
            self.recipe(what, gel, motion),
            gel.material.poisson_ratio,
            gel.material.mooney_ratio,
            friction,
            stops,
            read,
            arrays,
            must_reach,
        )

    def recipe(self, what: str, gel: Gel, motion: Mapping[str, Any]) -> dict[str, Any]:
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

    def presses(self, plans: Sequence[CurvePlan]) -> GelPresses:
        """Gels of 1 MPa at rest."""
        gels = [self.gel.with_law(plan.poisson_ratio, plan.mooney_ratio) for plan in plans]
        rubs = any(plan.friction for plan in plans)
        return GelPresses(
            self.mesh,
            [profile_material(gel.unit_material(), self.mesh) for gel in gels],
            self.tool.indenter(),
            self.tool.at_mm,
            [plan.friction for plan in plans],
            physics=self.gel.physics,
            # With much friction a step that does not converge soon will not, see ``tangential``.
            config=self.gel.physics.solver(**(RUBBING_LIMITS if rubs else {})),
            device=self.gel.device,
        )


@dataclass(frozen=True)
class Followed:
    """What became of plans that were simulated together."""

    rows: list[np.ndarray]
    """What was read of each, shape [stop that is read, ...], NaN where not reached."""
    reached: np.ndarray
    """Stops of each that were read, int, shape [plan]."""
    converged: np.ndarray
    """Whether the last stop was reached, bool, shape [plan]."""
    failure: str
    """Why the first one that failed did, in words."""
    seconds: float
    residual_n: np.ndarray
    """Largest force residual at the stops, shape [plan]."""


def batch_size(device: str) -> int:
    """How many environments a scene has on a device: one core gains nothing from more."""
    return CPU_BATCH if device == "cpu" else GPU_BATCH


def follow(
    env: GelPresses,
    plans: Sequence[CurvePlan],
    progress: Callable[[int, int], None] | None = None,
) -> Followed:
    """Take the tool of each environment along its stops, as far as they converge."""
    count = len(plans)
    read = plans[0].read
    rows: list[list[np.ndarray]] = [[] for _ in plans]
    lost, residual = np.zeros(count, dtype=bool), np.zeros(count)
    failure, seconds = "", 0.0
    steps = max(len(plan.stops) for plan in plans)
    for step in range(steps):
        over = np.array([step >= len(plan.stops) for plan in plans])
        stay = over | lost
        if stay.all():
            break
        if progress is not None:
            progress(step, steps)
        stops = [c.stops[min(step, len(c.stops) - 1)] for c in plans]
        report = env.go(stops, stay if stay.any() else None)
        seconds += report.seconds
        gone = ~report.converged & ~stay
        if gone.any() and not failure:
            first = int(np.argmax(gone))
            failure = env.failure(first, report, stops[first].depth_mm)
        lost |= gone
        here = [i for i in np.flatnonzero(~stay & ~gone).tolist() if stops[i].read]
        if here:
            found = read(env, plans)
            for i in here:
                rows[i].append(found[i])
                residual[i] = max(residual[i], report.residual_n[i])
    if not any(rows):
        # Nothing was reached anywhere: only the reader knows the shape of what is missing.
        like = np.full_like(read(env, plans)[0], np.nan)
    else:
        like = np.full_like(next(row[0] for row in rows if row), np.nan)
    reached = np.array([len(row) for row in rows])
    for plan, row in zip(plans, rows, strict=True):
        row += [like] * (sum(stop.read for stop in plan.stops) - len(row))
    return Followed([np.array(row) for row in rows], reached, ~lost, failure, seconds, residual)


def simulate_each(
    bench: GelBench,
    plans: Sequence[CurvePlan],
    progress: Progress = silent,
    task: str = "presses",
) -> Iterator[dict[str, np.ndarray]]:
    """``simulate`` each of the plans in turn, after ``prepare``.

    ``progress`` receives how many are done; whoever has seen enough may stop before the last.
    """
    prepare(bench, plans, progress, task)
    for done, plan in enumerate(plans):
        progress(task, done, len(plans))
        yield simulate(bench, plan)
    progress(task, len(plans), len(plans))


def simulate(bench: GelBench, plan: CurvePlan) -> dict[str, np.ndarray]:
    """The arrays of a plan and the ``seconds`` that it took, from the cache or simulated.

    Raises:
        SimulationError: It did not converge as far as it must.
    """

    def alone() -> dict[str, np.ndarray]:
        found = follow(bench.presses([plan]), [plan])
        if found.reached[0] < plan.must_reach:
            raise SimulationError(found.failure)
        return plan.arrays(found.rows[0]) | {"seconds": np.array(found.seconds)}

    return plan.kept.read_or_make(alone)


def prepare(
    bench: GelBench,
    plans: Sequence[CurvePlan],
    progress: Progress = silent,
    task: str = "presses",
) -> None:
    """Put into the cache what is missing there, where the device gains from many at a time.

    Candidates have one mesh, one tool and one kind of contact, with friction or without. Those that
    fail are left to ``simulate``. ``progress`` receives how many plans are done, and of how
    many.
    """
    size = batch_size(bench.device)
    missing = [plan for plan in plans if not plan.kept.exists()]
    if size < 2 or len(missing) < 2:
        return
    for first in range(0, len(missing), size):
        part = missing[first : first + size]
        done = len(plans) - len(missing) + first

        def on_step(step: int, steps: int, done: int = done, count: int = len(part)) -> None:
            progress(task, done + count * step // steps, len(plans))

        found = follow(bench.presses(part), part, on_step)
        seconds = np.array(found.seconds / len(part))
        for plan, rows, converged in zip(part, found.rows, found.converged, strict=True):
            if converged:
                plan.kept.write(plan.arrays(rows) | {"seconds": seconds})
