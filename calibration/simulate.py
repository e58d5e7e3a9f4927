# SPDX-License-Identifier: Apache-2.0
"""The gel surface under each captured press, from a finite-element simulation of that press.

A ball goes down on the designed pad where the capture's contact circle lies, until the simulated
contact has the circle's radius. The depth is not known from the image: it is found by a secant
search on the contact radius, all presses of a batch at once. How the gel sinks around the contact,
which no closed form gives for a layer of finite thickness, comes out of the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.captures import check_radius
from taccel_lab.calibration.surfaces.analytic import analytic_surface
from taccel_lab.calibration.surfaces.depth_search import EQUATOR_SHARE
from taccel_lab.calibration.surfaces.outcome_cache import kept_outcome
from taccel_lab.calibration.surfaces.press_batch import (
    RADIUS_TOLERANCE_PX,
    BatchOutcome,
    PressBatch,
    simulate_batch,
    surfaces_of,
)
from taccel_lab.calibration.surfaces.press_surface import PressSurface
from taccel_lab.calibration.surfaces.shared_law import (
    MIN_OTHERS,
    SPANNING,
    SharedLaw,
    spanning_presses,
)
from taccel_lab.calibration.surfaces.view import require_view_on_pad
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.presses.physics import SURFACE_PHYSICS, PressPhysics
from taccel_lab.processes.process_pool import Died, Finished, ProcessPool, usable_cores
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.registry import profile_parameters
from taccel_lab.signals.rest_surface import rest_surface

BATCH = 6
"""Presses simulated together in one process."""
SPANNING_BATCH = 3
"""The same for those that span others: two processes then share the work."""
TASK = "simulating the presses"

SurfaceMaker = Callable[[CaptureSet, Sequence[ContactCircle]], list[PressSurface]]
"""Surfaces of presses in circles, in order; InputError for a circle that the ball cannot leave,
SimulationError for one that does not converge."""


@dataclass(frozen=True)
class PressSurfaces:
    """Makes the surfaces of presses in circles; one law of simulated presses serves later ones."""

    kind: Literal["simulated", "each", "hertz"]
    """The simulation of the presses that span all others, from which the others are read where one
    law holds; the simulation of each; or a closed form (``surfaces.analytic``)."""
    profile: SensorProfile
    """The designed sensor, on the grid of the captures."""
    cache: bool = True
    """Keep simulated presses in the user's cache folder, and take what is there."""
    decay_mm: float = math.inf
    """Length over which the skirt of ``hertz`` is damped [mm]."""
    progress: Progress = silent
    laws: dict[float, SharedLaw] = field(default_factory=dict)

    def __call__(
        self, captures: CaptureSet, circles: Sequence[ContactCircle]
    ) -> list[PressSurface]:
        if self.kind in ("simulated", "each"):
            return simulate_presses(
                captures,
                circles,
                self.profile,
                cache=self.cache,
                share=self.kind == "simulated",
                laws=self.laws,
                progress=self.progress,
            )
        return [
            analytic_surface(
                circle,
                captures.grid,
                press.radius_mm or captures.ball_radius_mm,
                decay_mm=self.decay_mm,
            )
            for press, circle in zip(captures.presses, circles, strict=True)
        ]


def simulate_presses(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    profile: SensorProfile,
    *,
    physics: PressPhysics = SURFACE_PHYSICS,
    friction_coefficient: float = 0.0,
    processes: int | None = None,
    cache: bool = False,
    share: bool = False,
    laws: dict[float, SharedLaw] | None = None,
    progress: Progress = silent,
) -> list[PressSurface]:
    """Simulate the presses of ``captures`` and return their surfaces in order.

    Args:
        captures: Ball radius, pixel grid and names.
        circles: Contact circle of each press [px].
        profile: The designed sensor: family, parameters and material, that of a skin included.
        physics: How presses are simulated: as by ``press``, on a finer mesh.
        friction_coefficient: Between ball and gel. Frictionless presses fit best what the images
            of real ball presses show: the slope beside the contact that they imply falls off as
            without friction (docs/captures.md).
        processes: Worker processes; the number of cores, at most 8, when None.
        cache: Keep the outcomes in the user's cache folder, and take what is there.
        share: Simulate the presses of a ball that span the others only, and read the others off
            them, where one law explains those that were simulated (``surfaces.between``).
        laws: With ``share``, the laws of earlier presses of this sensor by the radius of the ball
            [mm]: they serve these presses too, and new ones are added.
        progress: Told how many presses are done.

    Raises:
        InputError: A circle that the ball cannot make.
        SimulationError: A press that did not converge.
    """
    if len(circles) != len(captures.presses):
        raise InputError(f"{len(circles)} contact circles for {len(captures.presses)} presses")
    for press, circle in zip(captures.presses, circles, strict=True):
        ball_mm = press.radius_mm or captures.ball_radius_mm
        check_radius(circle, captures.grid, ball_mm, f"{captures.source}: {press.name}")
    require_view_on_pad(profile, captures.grid, captures.mask, captures.source, "color")
    known = _KnownSurfaces(
        captures, circles, profile, physics, friction_coefficient, processes, cache, progress
    )
    if share:
        laws = {} if laws is None else laws
        for ball_mm, chosen in _of_ball(captures).items():
            known.share(ball_mm, chosen, laws)
    known.simulate(range(len(circles)))
    return [surface for surface in known.surfaces if surface is not None]


def _simulated(batch: PressBatch, progress: Progress) -> BatchOutcome | Exception:
    """A batch in a process of its own; what it refused or could not do is handed over."""
    try:
        return simulate_batch(batch)
    except (InputError, SimulationError) as error:
        return error


@dataclass
class _KnownSurfaces:
    """Surfaces of the presses, as far as they are known."""

    captures: CaptureSet
    circles: Sequence[ContactCircle]
    profile: SensorProfile
    physics: PressPhysics
    friction_coefficient: float
    processes: int | None
    cache: bool
    progress: Progress

    def __post_init__(self) -> None:
        self.rest = rest_surface(self.profile.mesh, self.captures.grid)
        self.surfaces: list[PressSurface | None] = [None] * len(self.circles)

    def share(self, ball_mm: float, presses: Sequence[int], laws: dict[float, SharedLaw]) -> None:
        """Read presses of one ball off the law where it holds; without one, simulate those that
        span them to find it."""
        circles = [self.circles[i] for i in presses]
        grid = self.captures.grid
        if ball_mm not in laws:
            if len(presses) < SPANNING + MIN_OTHERS:
                return
            spanning = [presses[k] for k in spanning_presses(circles)]
            self.simulate(spanning, SPANNING_BATCH)
            known = [surface for i in spanning if (surface := self.surfaces[i]) is not None]
            laws[ball_mm] = SharedLaw.of(known, [self.circles[i] for i in spanning], grid)
        if not laws[ball_mm].holds:
            return
        ball_px = ball_mm / grid.mm_per_px_x
        for i, circle in zip(presses, circles, strict=True):
            if self.surfaces[i] is None:
                radius_px = min(circle.radius_px, EQUATOR_SHARE * ball_px)
                self.surfaces[i] = laws[ball_mm].surface(circle, radius_px)
        self._tell()

    def simulate(self, presses: Sequence[int], size: int | None = None) -> None:
        """Simulate those of ``presses`` that have no surface yet, in batches."""
        wanted = [i for i in presses if self.surfaces[i] is None]
        batches = press_batches(
            self.captures, self.circles, self.profile, self.physics, self.friction_coefficient,
            wanted, size,
        )  # fmt: skip
        left = []
        for batch in batches:
            kept = kept_outcome(batch).read() if self.cache else None
            if kept is None:
                left.append(batch)
            else:
                self._place_batch(batch, kept)
        workers = min(self.processes or min(usable_cores(), 8), len(left))
        with ProcessPool(_simulated, workers if workers > 1 else 0) as pool:
            for event in pool.run(left):
                if isinstance(event, Died):
                    raise SimulationError(
                        f"presses {', '.join(map(str, event.item.presses))} were not simulated: "
                        f"{event.cause}"
                    )
                if isinstance(event, Finished):
                    if isinstance(event.result, Exception):
                        raise event.result
                    self._keep(event.item, event.result)

    def _keep(self, batch: PressBatch, outcome: BatchOutcome) -> None:
        if self.cache:
            kept_outcome(batch).write(outcome)
        self._place_batch(batch, outcome)

    def _place_batch(self, batch: PressBatch, outcome: BatchOutcome) -> None:
        found = surfaces_of(batch, outcome, self.captures, self.rest)
        for i, surface in zip(batch.presses, found, strict=True):
            self.surfaces[i] = surface
        self._tell()

    def _tell(self) -> None:
        self.progress(TASK, sum(s is not None for s in self.surfaces), len(self.surfaces))


def _of_ball(captures: CaptureSet) -> dict[float, list[int]]:
    """Indices of the presses of each ball, by its radius [mm]."""
    found: dict[float, list[int]] = {}
    for i, press in enumerate(captures.presses):
        found.setdefault(press.radius_mm or captures.ball_radius_mm, []).append(i)
    return found


def press_batches(
    captures: CaptureSet,
    circles: Sequence[ContactCircle],
    profile: SensorProfile,
    physics: PressPhysics,
    friction_coefficient: float,
    wanted: Sequence[int] | None = None,
    size: int | None = None,
) -> list[PressBatch]:
    """The presses, or those ``wanted``, in batches of ``size`` or ``BATCH``, each of one ball, in
    order."""
    pad = profile_parameters(profile).pad()
    # Environments of one scene have one connectivity.
    size = (size or BATCH) if pad.one_connectivity else 1
    grid = captures.grid
    at_mm = grid.gel_from_pixel(np.array([[c.u_px, c.v_px] for c in circles]))
    target_mm = np.array([c.radius_px for c in circles]) * grid.mm_per_px_x
    chosen_presses = set(range(len(circles)) if wanted is None else wanted)
    of_ball = {
        ball_mm: [i for i in indices if i in chosen_presses]
        for ball_mm, indices in _of_ball(captures).items()
    }
    return [
        PressBatch(
            presses=tuple(chosen),
            at_mm=at_mm[chosen],
            target_mm=target_mm[chosen],
            tolerance_mm=RADIUS_TOLERANCE_PX * grid.mm_per_px_x,
            ball_radius_mm=ball_mm,
            pad=pad,
            material=profile.material,
            friction=friction_coefficient,
            physics=physics,
        )
        for ball_mm, indices in of_ball.items()
        for chosen in (indices[k : k + size] for k in range(0, len(indices), size))
    ]
