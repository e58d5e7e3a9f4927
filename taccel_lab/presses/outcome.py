# SPDX-License-Identifier: Apache-2.0
"""A whole press of one environment and everything a sensor reads at its end.

The contact face is finer than the mesh: the object's surface where it touches, the gel's elsewhere
(``FineSurface``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import View
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.ipc.potentials.elements.inversion import smallest_ratios
from taccel_lab.outputs import Outputs
from taccel_lab.presses.env import PressEnv
from taccel_lab.presses.indenter import Indenter
from taccel_lab.presses.path import HOLD_STEPS, PressPath
from taccel_lab.presses.physics import PressPhysics
from taccel_lab.presses.setup import PressSetup
from taccel_lab.presses.states import PressStates, PressSurface
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import RestSurface
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.solvers import StepReport
from taccel_lab.summary import Summary
from taccel_lab.with_error import with_error


@dataclass(frozen=True)
class SeenFrom:
    """A camera that looks at a press."""

    camera: View
    """Camera, or its pixels laid over the gel."""
    designed_rest: RestSurface | None = None
    """The pad's contact face on ``face_of(camera)``, where a mesh draws it more coarsely, see
    ``RestSurface.left_out_by``."""
    points: int | None = None
    """Samples along each side of a pixel, see ``FineSurface``."""


@dataclass(frozen=True)
class PressStep:
    """One converged step."""

    depth_mm: float
    shear_mm: tuple[float, float]
    twist_deg: float
    wrench: np.ndarray
    """Force [N] and moment about the gel's origin [N m] of the gel on the indenter, [6]."""
    report: StepReport
    time_s: float | None = None
    """Time since first touch [s]; None of a gel that does not relax."""


@dataclass(frozen=True)
class PressStop:
    """The step that a press did not finish."""

    depth_mm: float
    shear_mm: tuple[float, float]
    twist_deg: float
    why: str


@dataclass(frozen=True, repr=False)
class PressOutcome(Summary):
    """The steps of a press and the signals at its end, or at the last step that it finished."""

    mesh: TetMesh | QuadraticMesh
    """The gel with all its nodes: middles of edges too where its elements are quadratic."""
    setup: PressSetup
    path: PressPath
    steps: list[PressStep]
    force_error_n: float
    """Numerical error of the last force [N], see ``measured_press``; NaN where none is known."""
    height_error_m: float
    """Numerical error of the heights, root mean square [m]; NaN where none is known."""
    positions_m: np.ndarray
    """Deformed gel nodes [m], shape [node, 3]."""
    contact_forces_n: np.ndarray
    """Force of the indenter on each gel node [N], shape [node, 3]."""
    contact_pressures_pa: np.ndarray
    """Contact pressure at each gel node [Pa], see ``SurfaceLoad``, shape [node]."""
    von_mises_pa: np.ndarray
    """Equivalent stress at each gel node [Pa], shape [node]."""
    indenter_pose: np.ndarray
    """gel_from_indenter: position [m], quaternion x, y, z, w; shape [7]. Held back by
    ``setback_m`` from the depth."""
    setback_m: float
    """Mean gap that the contact keeps, see ``PressEnv`` [m]."""
    height_m: np.ndarray
    """z of the contact face [m], NaN outside the pad, shape [height_px, width_px]."""
    rest_height_m: np.ndarray
    normals: np.ndarray
    rest_normals: np.ndarray
    contact_mask: np.ndarray
    """Pixels in contact, shape [height_px, width_px]."""
    contact_radius_m: float
    """Radius of the disc of the contact's area [m]."""
    smallest_volume_ratio: float
    """Smallest det F anywhere in a tet: above 0 when no tet is inverted."""
    guard_share: float = 0.0
    """Part of the last force that depends on what keeps tets from turning inside out, see
    ``PressEnv.guard_share``; 0 unless they are squeezed to a tenth of their volume."""
    fine_force_n: float | None = None
    """Force against the press of the contact with a texture, of which the solver's force knows the
    mean surface only [N]; None without a texture."""
    shear_error_n: float = math.nan
    """Numerical error of the last sideways force [N]; NaN where none is known."""
    moment_error_nm: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """Numerical errors of the last moments [N m]; NaN likewise."""
    steps_share: float | None = None
    """Share of the normal force that the length of the steps adds, by a press in half as many; None
    where that was not asked."""
    steps_wrench: np.ndarray | None = None
    """What they add to the last wrench [N], [N m], [6]; None likewise."""
    states: PressStates | None = None
    """All steps, where they were to be kept."""
    stopped: PressStop | None = None
    """Where and why the press ended before its path did."""
    views: Mapping[str, PressSurface] = field(default_factory=dict)
    """What further cameras show at the end, by name."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Depth, force with its estimated error, and what the last step ended with."""
        final = self.steps[-1]
        return f"press to {final.depth_mm:.4g} mm", [
            ("force", f"{with_error(self.force_n, self.force_error_n)} N"),
            ("gel", f"{self.mesh.node_count} nodes, {self.mesh.tet_count} tets"),
            ("last step", final.report.summary()),
        ]

    @property
    def physics(self) -> PressPhysics:
        """Element, contact range and tolerance."""
        return self.setup.physics

    @property
    def wrench(self) -> np.ndarray:
        """Force [N] and moment about the gel's origin [N m] of the gel on the indenter, [6]."""
        return self.steps[-1].wrench

    @property
    def force_n(self) -> float:
        """Normal force of the gel on the indenter [N]."""
        return float(self.wrench[2])

    @property
    def largest_n(self) -> float:
        """Normal force at the end, or the largest of a way there and back, which ends without
        [N]."""
        forces = [float(step.wrench[2]) for step in self.steps]
        return max(forces) if self.path.back else forces[-1]

    @property
    def travel_mm(self) -> float:
        """Largest travel of the indenter past first touch [mm]."""
        return max(step.depth_mm for step in self.steps)

    def seen_by(self, name: str) -> PressOutcome:
        """Return the outcome with the pixels of one of ``views``, without states."""
        return replace(self, **vars(self.views[name]), views={}, states=None)

    @property
    def last(self) -> StepReport:
        return self.steps[-1].report

    def figures(self) -> dict[str, Any]:
        """Return the numbers of the press for a JSON file: no times, so equal presses are equal."""
        steps = [step.report for step in self.steps]
        wrench = self.wrench
        return {
            "travel_mm": self.travel_mm,
            "force_n": float(wrench[2]),
            "force_error_n": self.force_error_n,
            "height_error_m": self.height_error_m,
            "guard_share": self.guard_share,
            "wrench": {"force_n": wrench[:3], "moment_nm": wrench[3:]},
            "residual_n": float(self.last.residual_n[0]),
            "contact_force_sum_n": float(self.last.contact_force_n[0]),
            "newton_iterations": int(sum(r.newton_iterations[0] for r in steps)),
            "cg_iterations": int(sum(r.cg_iterations[0] for r in steps)),
            "friction_lags": int(sum(r.friction_lags[0] for r in steps)),
            "step_count": len(steps),
            "min_distance_m": float(min(r.min_distance_m[0] for r in steps)),
            "setback_m": self.setback_m,
            "contact_radius_mm": self.contact_radius_m * 1e3,
            "fine_force_n": self.fine_force_n,
            "smallest_volume_ratio": self.smallest_volume_ratio,
            "stopped": None if self.stopped is None else asdict(self.stopped),
            **self._loop(),
            "steps": [
                {
                    **({} if step.time_s is None else {"time_s": step.time_s}),
                    "depth_mm": step.depth_mm,
                    "shear_mm": step.shear_mm,
                    "twist_deg": step.twist_deg,
                    "force_n": step.wrench[:3],
                    "moment_nm": step.wrench[3:],
                    "residual_n": float(step.report.residual_n[0]),
                    "newton_iterations": int(step.report.newton_iterations[0]),
                    "cg_iterations": int(step.report.cg_iterations[0]),
                    "friction_lags": int(step.report.friction_lags[0]),
                    "min_distance_m": float(step.report.min_distance_m[0]),
                }
                for step in self.steps
            ],
        }

    def _loop(self) -> dict[str, Any]:
        """How the force fell in a hold, and the work [mJ] of the normal force of a way down and
        back; of presses that have them."""
        found: dict[str, Any] = {}
        forces = np.array([0.0] + [step.wrench[2] for step in self.steps])
        depths = np.array([0.0] + [step.depth_mm for step in self.steps])
        first = len(self.path.way_there())
        if self.path.hold_s > 0 and len(self.steps) >= first + HOLD_STEPS:
            before, after = float(forces[first]), float(forces[first + HOLD_STEPS])
            found["hold"] = {"from_n": before, "to_n": after, "seconds": self.path.hold_s}
        if self.path.back and self.stopped is None:
            works = 0.5 * (forces[1:] + forces[:-1]) * np.diff(depths)
            done, lost = float(works[works > 0].sum()), float(works.sum())
            found["loop"] = {"work_mj": done, "lost_mj": lost, "lost_share": lost / done}
        return found


def simulate_press(
    setup: PressSetup,
    at_mm: tuple[float, float],
    path: PressPath,
    seen: SeenFrom,
    *,
    views: Mapping[str, SeenFrom] | None = None,
    progress: Callable[[int, int, PressStep], None] | None = None,
    stopped: Callable[[PressOutcome], None] | None = None,
    keep_states: bool = False,
    beside: PressPath | None = None,
    limits: Mapping[str, int] | None = None,
) -> PressOutcome:
    """Press once, read everything. An indenter with a texture must go deeper than that is on the
    mean.

    Args:
        setup: Gel, tool and physics.
        at_mm: Gel xy of the tool's axis.
        path: Its way.
        seen: Camera whose pixels are read at the end.
        views: Further ones, by name.
        progress: Receives step, step count and outcome.
        stopped: Receives, where a step fails or an interrupt comes, the steps before, if there are
            any, and what can be read at their end; the error goes on.
        keep_states: Whether gel, loads and pixels of every step are kept, at 0.1 to 0.3 s each.
        beside: Path of the press that this one stands beside: once more in half as many steps, it
            tells what that path's steps add.
        limits: Fields of ``SolverConfig`` on which no result depends, see ``PressPhysics.solver``.

    Raises:
        InputError, SimulationError: As of ``PressEnv``.
    """
    indenter = setup.indenter
    env = PressEnv(setup, np.array([at_mm]), config=setup.physics.solver(**(limits or {})))
    env.places.kept = beside is not None
    texture = indenter.texture
    if texture is not None and not path.depth_mm * 1e-3 > texture.mean_depth_m:
        raise InputError(
            f"depth {path.depth_mm:g} mm ends above the mean surface of the texture, which lies "
            f"{1e3 * texture.mean_depth_m:.3g} mm below its highest points: press deeper"
        )
    waypoints = path.waypoints()
    times = np.cumsum(path.durations_s()) if env.relaxes else None
    steps: list[PressStep] = []
    states = PressStates() if keep_states else None
    outputs = Outputs(env.solver)

    def pixels() -> PressSurface:
        return press_surface(env, indenter, seen)

    def keep(done: int, total: int, report: StepReport) -> None:
        time_s = None if times is None else float(times[done - 1])
        steps.append(PressStep(*waypoints[done - 1], env.wrench[0].copy(), report, time_s))
        if states is not None:
            states.add(env, outputs.update(env.state), pixels)
        if progress is not None:
            progress(done, total, steps[-1])

    def read(stop: PressStop | None = None) -> PressOutcome:
        further = {name: press_surface(env, indenter, one) for name, one in (views or {}).items()}
        return _read(env, setup, path, steps, outputs, pixels(), further, states, stop)

    try:
        env.follow(path, keep)
    except BaseException as error:
        broken = isinstance(error, Exception) and not isinstance(error, SimulationError)
        if stopped is None or not steps or broken:
            raise
        if states is not None and not states.cut(len(steps)):
            states.add(env, outputs.update(env.state), pixels)
        why = str(error) or "interrupted"
        stopped(read(PressStop(*waypoints[min(len(steps), len(waypoints) - 1)], why)))
        raise
    outcome = read()
    if beside is None:
        return outcome
    added = steps_added(env, path, beside, outcome.wrench, outcome.largest_n)
    return replace(outcome, steps_share=added[0], steps_wrench=added[1])


def steps_added(
    env: PressEnv, path: PressPath, beside: PressPath, wrench: np.ndarray, normal_n: float
) -> tuple[float, np.ndarray]:
    """Share of the normal force [1] and wrench [6] that the steps of ``beside`` add: of first
    order, so that n steps add 1 / (n / m - 1) of what m fewer ones change (Richardson). Steps down
    and aside are not halved alike; most hangs on those that became the fewest.

    Args:
        env: A press that went along ``path``; it goes again.
        path: The same way as ``beside``, in as many steps or fewer.
        beside: Path whose steps add that.
        wrench: At the end of ``path``, of the first environment [N], [N m].
        normal_n: Its largest normal force [N].
    """
    count = sum(path.counts)
    fewer = path.with_steps(max(1, count // 2) / count)
    ratio = max(n / max(m, 1) for n, m in zip(path.counts, fewer.counts, strict=True))
    if ratio == 1 or not normal_n:
        return 0.0, np.zeros(6)
    env.reset()
    found = [np.zeros(6)]
    env.follow(fewer, lambda *_: found.append(env.wrench[0].copy()))
    forces = [float(wrench[2]) for wrench in found]
    largest = max(forces) if path.back else forces[-1]
    less = count / sum(beside.counts) / (ratio - 1)
    return less * (largest / normal_n - 1), less * (found[-1] - wrench)


def _read(
    env: PressEnv,
    setup: PressSetup,
    path: PressPath,
    steps: list[PressStep],
    outputs: Outputs,
    seen: PressSurface,
    views: Mapping[str, PressSurface],
    states: PressStates | None,
    stop: PressStop | None,
) -> PressOutcome:
    outputs.update(env.state)
    pressures = outputs.surface_load.pressures.numpy()[:, : env.model.soft_count].copy()
    error = env.error_estimate()
    return PressOutcome(
        mesh=env.mesh,
        setup=setup,
        path=path,
        steps=steps,
        force_error_n=float(error.force_n[0]),
        height_error_m=float(error.height_m[0]),
        positions_m=env.positions[0].copy(),
        contact_forces_n=env.contact_forces[0].copy(),
        contact_pressures_pa=pressures[0],
        von_mises_pa=outputs.von_mises.numpy()[0, : env.model.soft_count].copy(),
        indenter_pose=env.poses[0, 0],
        setback_m=float(env.setback_m[0]),
        smallest_volume_ratio=float(smallest_ratios(env.solver.elastic, env.state.positions)[0]),
        guard_share=float(env.guard_share()[0]),
        states=states,
        stopped=stop,
        views=views,
        **vars(seen),
    )


def press_surface(env: PressEnv, indenter: Indenter, seen: SeenFrom) -> PressSurface:
    """Pixels of the first environment of a press that has converged; at rest, of the points that
    they show now."""
    fine = FineSurface(
        env.solver,
        indenter.name,
        seen.camera,
        texture=indenter.texture,
        designed_rest=seen.designed_rest,
        points=seen.points,
        env_count=1,
    )
    signal = SignalTactile.from_solver(env.solver, seen.camera, fine=fine)
    signal.update(env.state, who=np.arange(env.model.env_count) == 0)
    height, normals, contact = (
        array.numpy()[0] for array in signal.read("height_m", "normals", "contact")
    )
    rest = signal.rest_samples().numpy()[0].astype(np.float64)
    return PressSurface(
        height_m=height.astype(np.float64),
        rest_height_m=rest[..., 2],
        normals=normals.astype(np.float64),
        rest_normals=normals_from_slopes(rest[..., :2]),
        contact_mask=contact.astype(bool),
        contact_radius_m=math.sqrt(fine.contact_area_m2[0] / math.pi),
        fine_force_n=None if indenter.texture is None else fine.pressed_n,
    )


def contact_radii_m(
    env: PressEnv, indenter: Indenter, grid: PixelGrid, frames: np.ndarray, points: int = 1
) -> np.ndarray:
    """Radii of the discs of the contacts' areas of a press that has converged [m], [env_count].

    Args:
        env: The press.
        indenter: Its indenter.
        grid: Pixels, about the origin of the frames, that hold the contacts.
        frames: gel_from_frame in which each contact is looked at along z, [env_count, 7].
        points: Samples along each side of a pixel.
    """
    fine = FineSurface(env.solver, indenter.name, grid, texture=indenter.texture, points=points)
    signal = SignalTactile.from_solver(env.solver, grid, fine=fine)
    seen = wp.array(frames, dtype=wp.transformd, device=env.model.device)
    signal.update(env.state, seen)
    signal.read("contact")
    return np.sqrt(fine.contact_area_m2 / np.pi)
