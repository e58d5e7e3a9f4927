# SPDX-License-Identifier: Apache-2.0
"""Touches of one sensor by one object, simulated together, and what their channels say.

Each is the press that ``taccel-lab press`` would be: mesh, contact range and tolerance are those of
its own ``PressSetup``, so that its company changes nothing. A touch that cannot be set up, or that
does not converge, keeps the steps before and says why.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from taccel_lab.datasets.channels import NODAL, Channel
from taccel_lab.datasets.motion import Touch, TouchRecord, failed_touch
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.datasets.view import TouchView
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region
from taccel_lab.presses import PressEnv
from taccel_lab.presses.path import rolled_mm
from taccel_lab.solvers import EnvStatus

StepProgress = Callable[[int, int], None]
"""Receives how many steps are done, of how many."""


@dataclass(frozen=True, eq=False)
class TouchBench:
    """What all touches of a batch share."""

    sensor: Sensor
    channels: Sequence[Channel]
    patches: tuple[int, int] = (8, 6)
    progress: StepProgress = field(default=lambda done, total: None)


def simulate_touches(touches: Sequence[Touch], bench: TouchBench) -> list[TouchRecord]:
    """Simulate touches side by side; those of one connectivity and contact range are environments
    of one batch."""
    groups: dict[str, list[int]] = {}
    for place, touch in enumerate(touches):
        groups.setdefault(touch.setup.batch_key, []).append(place)
    found: dict[int, TouchRecord] = {}
    for places in groups.values():
        chosen = [touches[place] for place in places]
        try:
            records = _simulate(chosen, bench)
        except InputError:
            # One that cannot be set up is named by being alone.
            records = [_alone(touch, bench) for touch in chosen]
        found |= dict(zip(places, records, strict=True))
    return [found[place] for place in range(len(touches))]


def _alone(touch: Touch, bench: TouchBench) -> TouchRecord:
    try:
        return _simulate([touch], bench)[0]
    except InputError as error:
        return failed_touch(touch.episode, len(touch.commands), str(error))


def _simulate(touches: Sequence[Touch], bench: TouchBench) -> list[TouchRecord]:
    first, count = touches[0], len(touches)
    frictions = [touch.setup.friction_coefficient for touch in touches]
    env = PressEnv(
        replace(first.setup, friction_coefficient=max(frictions)),
        np.zeros((count, 2)),
        rest_positions_m=np.stack([touch.setup.mesh.nodes_m for touch in touches]),
        gel_from_press=np.stack([touch.frame for touch in touches]),
    )
    _set_parameters(env, touches, bench)
    meshes = [env.nodal(touch.setup.mesh) for touch in touches]
    view = TouchView(
        env,
        touches,
        meshes,
        bench.sensor,
        patches=bench.patches,
        channels=[channel.name for channel in bench.channels],
    )
    rows: list[list[dict[str, np.ndarray]]] = [[] for _ in touches]
    causes = [""] * count
    lengths = np.array([len(touch.commands) for touch in touches])
    height_mm = 1e3 * env.touch_m

    def keep(who: np.ndarray) -> None:
        arrays = {c.name: np.asarray(c.read(view)) for c in bench.channels}
        for row, one in enumerate(who.tolist()):
            # Copies, as the arrays of signals are written anew at the next step.
            rows[one].append({c.name: arrays[c.name][row].astype(c.dtype) for c in bench.channels})

    view.at(0, np.arange(count), np.zeros((count, 6)), None)
    keep(np.arange(count))
    failed = np.zeros(count, dtype=bool)
    for step in range(1, int(lengths.max(initial=0)) + 1):
        resting = failed | (lengths < step)
        if resting.all():
            break
        asked = np.stack([t.commands[min(step, len(t.commands)) - 1] for t in touches])
        report = env.try_to(
            asked[:, 0], asked[:, 1:3] + rolled_mm(asked, height_mm), asked[:, 3:6], stay=resting
        )
        lost = ~report.converged & ~resting
        for i in np.flatnonzero(lost).tolist():
            causes[i] = (
                f"step {step} of {lengths[i]}, depth {asked[i, 0]:.3g} mm: "
                f"{EnvStatus(report.status[i]).name}, residual {report.residual_n[i]:.1e} N of "
                f"{report.contact_force_n[i]:.3g} N after {report.newton_iterations[i]} Newton "
                "iterations, in halves of the step too"
            )
        failed |= lost
        who = np.flatnonzero(~resting & ~lost)
        if len(who):
            view.at(step, who, asked[who], report)
            keep(who)
        bench.progress(step, int(lengths.max()))
    node, faces = view.face_nodes, env.mesh.region_faces(Region.CONTACT)
    compact = np.searchsorted(node, faces).astype(np.int32)
    return [
        TouchRecord(
            touch.episode,
            {name: np.stack([row[name] for row in kept]) for name in kept[0]},
            len(touch.commands),
            cause,
            touch.frame,
            mesh.nodes_m[node],
            compact,
        )
        for touch, kept, cause, mesh in zip(touches, rows, causes, meshes, strict=True)
    ]


def _set_parameters(env: PressEnv, touches: Sequence[Touch], bench: TouchBench) -> None:
    """Each environment's own modulus, Poisson's ratio and friction, where they differ."""
    model = env.model
    gel, tool = model.scene.soft_bodies[0], model.scene.kinematic_bodies[0]
    factors = np.array([touch.young_modulus_factor for touch in touches])
    ratios = [bench.sensor.units[touch.unit].poisson_ratio for touch in touches]
    if (factors != 1).any() or any(ratio is not None for ratio in ratios):
        young = np.asarray(gel.material.young_modulus_pa, dtype=np.float64)
        poisson = np.asarray(gel.material.poisson_ratio, dtype=np.float64)
        shape = (len(touches), *young.shape)
        own = np.array([np.nan if ratio is None else ratio for ratio in ratios])
        own = own.reshape(-1, *(1,) * young.ndim)
        model.set_body(
            gel.name,
            young_modulus_pa=factors.reshape(own.shape) * np.broadcast_to(young, shape),
            poisson_ratio=np.where(np.isnan(own), np.broadcast_to(poisson, shape), own),
        )
    frictions = np.array([touch.setup.friction_coefficient for touch in touches])
    if (frictions != frictions.max()).any():
        model.set_friction(gel.name, tool.name, frictions)


def joined(records: Sequence[TouchRecord], channels: Sequence[Channel]) -> dict[str, np.ndarray]:
    """Rows of all touches after one another, by channel; nodal rows as long as the longest."""
    found = {}
    for channel in channels:
        arrays = [record.rows[channel.name] for record in records if record.rows]
        if channel.name in NODAL and arrays:
            most = max(array.shape[1] for array in arrays)
            arrays = [_padded(array, most) for array in arrays]
        found[channel.name] = np.concatenate(arrays) if arrays else np.zeros(0, dtype=channel.dtype)
    return found


def _padded(array: np.ndarray, nodes: int) -> np.ndarray:
    short = [(0, 0)] * array.ndim
    short[1] = (0, nodes - array.shape[1])
    return np.pad(array, short)
