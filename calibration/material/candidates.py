# SPDX-License-Identifier: Apache-2.0
"""Candidates of a material: presses that a table asks for, each alone or many in one scene.

Each is kept on disk for itself. A GPU takes those that are missing together, as environments of one
scene, and what does not converge there is tried again alone; one core is quicker with one at a time
(docs/calibration_material.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from taccel_lab.calibration.material.gel_presses import GelPresses, Stop
from taccel_lab.calibration.material.store import is_kept, keep, kept
from taccel_lab.errors import SimulationError

CPU_BATCH, GPU_BATCH = 1, 128
"""Environments a scene."""

Reader = Callable[[], np.ndarray]
"""What is read of all environments where they are, shape [env, ...]."""


@dataclass(frozen=True)
class Candidate:
    """One gel and the way of the tool on it."""

    recipe: Mapping[str, Any]
    """All that its forces depend on, the key in the cache."""
    poisson_ratio: float
    mooney_ratio: float
    friction: float
    stops: Sequence[Stop]
    reader: Callable[[GelPresses, Sequence[Candidate]], Reader]
    """Of a scene that was just built, and the candidates of its environments."""
    arrays: Callable[[np.ndarray], dict[str, np.ndarray]]
    """What is kept, from what was read, shape [stop that is read, ...], NaN where not reached."""
    must_reach: int = 0
    """How many of the stops that are read have to be reached; beyond them, what was not reached is
    NaN."""


class Bench(Protocol):
    """Where the presses of one tool on one mesh are simulated."""

    @property
    def device(self) -> str: ...

    def presses(self, candidates: Sequence[Candidate]) -> GelPresses:
        """Gels of 1 MPa at rest, an environment each."""
        ...


@dataclass(frozen=True)
class Followed:
    """What became of candidates that were simulated together."""

    rows: list[np.ndarray]
    """What was read of each, shape [stop that is read, ...], NaN where not reached."""
    reached: np.ndarray
    """Stops of each that were read, int, shape [candidate]."""
    converged: np.ndarray
    """Whether the last stop was reached, bool, shape [candidate]."""
    failure: str
    """Why the first one that failed did, in words."""
    seconds: float
    residual_n: np.ndarray
    """Largest force residual at the stops, shape [candidate]."""


def batch_size(device: str) -> int:
    """How many environments a scene has on a device: one core gains nothing from more."""
    return CPU_BATCH if device == "cpu" else GPU_BATCH


def follow(
    env: GelPresses,
    candidates: Sequence[Candidate],
    progress: Callable[[int, int], None] | None = None,
) -> Followed:
    """Take the tool of each environment along its stops, as far as they converge."""
    count = len(candidates)
    read = candidates[0].reader(env, candidates)
    rows: list[list[np.ndarray]] = [[] for _ in candidates]
    lost, residual = np.zeros(count, dtype=bool), np.zeros(count)
    failure, seconds = "", 0.0
    steps = max(len(candidate.stops) for candidate in candidates)
    for step in range(steps):
        over = np.array([step >= len(candidate.stops) for candidate in candidates])
        stay = over | lost
        if stay.all():
            break
        if progress is not None:
            progress(step, steps)
        stops = [c.stops[min(step, len(c.stops) - 1)] for c in candidates]
        report = env.go(stops, stay if stay.any() else None)
        seconds += report.seconds
        gone = ~report.converged & ~stay
        if gone.any() and not failure:
            first = int(np.argmax(gone))
            failure = env.failure(first, report, stops[first].depth_mm)
        lost |= gone
        here = [i for i in np.flatnonzero(~stay & ~gone).tolist() if stops[i].read]
        if here:
            found = read()
            for i in here:
                rows[i].append(found[i])
                residual[i] = max(residual[i], report.residual_n[i])
    if not any(rows):
        # Nothing was reached anywhere: only the reader knows the shape of what is missing.
        like = np.full_like(read()[0], np.nan)
    else:
        like = np.full_like(next(row[0] for row in rows if row), np.nan)
    reached = np.array([len(row) for row in rows])
    for candidate, row in zip(candidates, rows, strict=True):
        row += [like] * (sum(stop.read for stop in candidate.stops) - len(row))
    return Followed([np.array(row) for row in rows], reached, ~lost, failure, seconds, residual)


def simulate(bench: Bench, candidate: Candidate) -> dict[str, np.ndarray]:
    """The arrays of a candidate and the ``seconds`` that it took, from the cache or simulated.

    Raises:
        SimulationError: It did not converge as far as it must.
    """

    def alone() -> dict[str, np.ndarray]:
        found = follow(bench.presses([candidate]), [candidate])
        if found.reached[0] < candidate.must_reach:
            raise SimulationError(found.failure)
        return candidate.arrays(found.rows[0]) | {"seconds": np.array(found.seconds)}

    return kept(candidate.recipe, alone)


def prepare(
    bench: Bench,
    candidates: Sequence[Candidate],
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Put into the cache what is missing there, where the device gains from many at a time.

    Candidates have one mesh, one tool and one kind of contact, with friction or without. Those that
    fail are left to ``simulate``. ``progress`` is told how many candidates are done, and of how
    many.
    """
    size = batch_size(bench.device)
    missing = [candidate for candidate in candidates if not is_kept(candidate.recipe)]
    if size < 2 or len(missing) < 2:
        return
    for first in range(0, len(missing), size):
        part = missing[first : first + size]
        done = len(candidates) - len(missing) + first

        def told(step: int, steps: int, done: int = done, count: int = len(part)) -> None:
            if progress is not None:
                progress(done + count * step // steps, len(candidates))

        found = follow(bench.presses(part), part, told)
        seconds = np.array(found.seconds / len(part))
        for candidate, rows, converged in zip(part, found.rows, found.converged, strict=True):
            if converged:
                keep(candidate.recipe, candidate.arrays(rows) | {"seconds": seconds})
