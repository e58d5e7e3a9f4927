# SPDX-License-Identifier: Apache-2.0
"""Standard presses of designs, simulated: jobs of one connectivity, indenter and path are
environments of one batch.

A quasi-static press at given depths depends on the ratios of the layers' moduli alone: contact
stiffness, elastic forces and friction all scale with Young's modulus, so that positions stay and
forces scale. Jobs therefore hold no modulus; density has no effect at all.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.model.embedding import rotate
from taccel_lab.outputs import Outputs
from taccel_lab.presses import (
    Indenter,
    PressEnv,
    PressPath,
    PressSetup,
    layered_material,
    parse_indenter,
)
from taccel_lab.presses.frame import face_frame
from taccel_lab.presses.outcome import contact_radii_m
from taccel_lab.scene import Ball, Material
from taccel_lab.sensors.base import FamilyParameters
from taccel_lab.signals import ContactFaceMesh
from taccel_lab.studies.presses.press_record import PressRecord
from taccel_lab.studies.presses.standard import StandardPress

REFERENCE_PA = 1e5
"""Young's modulus of layer 0 in every simulation."""
CPU_BATCH, GPU_BATCH = 8, 256
"""Environments a batch. One core gains nothing from more; a failure to build splits a batch."""


@dataclasses.dataclass(frozen=True)
class Simulated:
    """The record of a job, and its share of the wall time."""

    record: PressRecord
    seconds: float


def batch_size(device: str) -> int:
    """How many environments go well together on a device."""
    return CPU_BATCH if device == "cpu" else GPU_BATCH


def simulate(jobs: Sequence[PressJob], device: str = "cpu") -> list[Simulated]:
    """Simulate jobs of one ``batch_key``; forces are those of ``REFERENCE_PA``.

    A job that fails has a record with a cause and the steps before. Where one of a batch cannot
    even be set up, each is taken on its own.
    """
    started = time.perf_counter()
    try:
        records = _press(jobs, device)
    except InputError as error:
        if len(jobs) > 1:
            return [simulate([job], device)[0] for job in jobs]
        records = [_nothing(jobs[0], str(error), device)]
    seconds = (time.perf_counter() - started) / len(jobs)
    return [Simulated(record, seconds) for record in records]


def _press(jobs: Sequence[PressJob], device: str) -> list[PressRecord]:
    first = jobs[0]
    indenter = first.setup.indenter
    frames = np.stack([job.gel_from_press for job in jobs])
    env = PressEnv(
        replace(first.setup, device=device),
        np.zeros((len(jobs), 2)),
        rest_positions_m=np.stack([job.setup.mesh.nodes_m for job in jobs]),
        gel_from_press=frames,
    )
    press = first.press
    thickness_mm = env.thickness_m * 1e3
    depth_mm = np.array([press.full_depth_mm(t) for t in thickness_mm])
    meshes = [env.nodal(job.setup.mesh) for job in jobs]
    surface = ContactFaceMesh.from_mesh(env.mesh)
    rest = np.stack([mesh.nodes_m for mesh in meshes])
    outputs = Outputs(env.solver)
    steps: list[list[dict[str, np.ndarray | float]]] = [[] for _ in jobs]
    radii_mm: list[list[float]] = [[] for _ in jobs]
    causes = [""] * len(jobs)
    failed = np.zeros(len(jobs), dtype=bool)
    waypoints = press.waypoints()
    for number, point in enumerate(waypoints):
        shear_mm = np.column_stack([point.shear * press.shear_fraction * depth_mm, 0 * depth_mm])
        twist_deg = point.twist * press.twist_deg
        report = env.try_to(depth_mm * point.depth, shear_mm, twist_deg, stay=failed)
        lost = ~report.converged & ~failed
        for i in np.flatnonzero(lost).tolist():
            why = env.failure(i, report, depth_mm * point.depth)
            causes[i] = f"step {number + 1} of {len(waypoints)}: {why}"
        failed |= lost
        if failed.all():
            break
        wrench, poses, positions = env.wrench, env.poses[:, 0], env.positions
        force, peaks = env.press_force, outputs.update(env.state).bond_peak()[0].numpy()
        contact_mm = measured_contact_mm(env, indenter, frames)
        for i in np.flatnonzero(~failed).tolist():
            if contact_mm is not None:
                radii_mm[i].append(float(contact_mm[i]))
            frame = jobs[i].gel_from_press
            moment = wrench[i, 3:] - np.cross(frame[:3], wrench[i, :3])
            axis = rotate(frame[3:], np.array([0.0, 0.0, 1.0]))
            steps[i].append({
                "depth_mm": depth_mm[i] * point.depth,
                "shear_mm": shear_mm[i, 0],
                "twist_deg": twist_deg,
                "force_n": force[i],
                "torque_nm": float(moment @ axis),
                "indenter_poses": poses[i],
                "moved_m": (positions[i] - rest[i]).astype(np.float32),
                "bond_peak_pa": peaks[i],
                "residual_n": report.residual_n[i],
                "newton_iterations": report.newton_iterations[i],
            })  # fmt: skip
    return [
        PressRecord(
            press=job.press.name,
            indenter=job.setup.indenter.name,
            place=job.place,
            mesh=meshes[i],
            surface=surface,
            gel_from_press=job.gel_from_press,
            thickness_mm=float(thickness_mm[i]),
            step_count=len(waypoints),
            cause=causes[i],
            contact_radius_mm=np.array(radii_mm[i]) if radii_mm[i] else None,
            device=device,
            **_stacked(steps[i], meshes[i].node_count),
        )
        for i, job in enumerate(jobs)
    ]


_SHAPES: dict[str, tuple[int, ...]] = {
    "depth_mm": (),
    "shear_mm": (),
    "twist_deg": (),
    "force_n": (3,),
    "torque_nm": (),
    "indenter_poses": (7,),
    "bond_peak_pa": (),
    "residual_n": (),
    "newton_iterations": (),
}


def _stacked(steps: list[dict[str, np.ndarray | float]], node_count: int) -> dict[str, np.ndarray]:
    """Arrays over the steps; of length 0 where there is none."""
    shapes = {**_SHAPES, "moved_m": (node_count, 3)}
    return {
        name: np.array([step[name] for step in steps]).reshape(-1, *shape)
        for name, shape in shapes.items()
    }


def _nothing(job: PressJob, cause: str, device: str) -> PressRecord:
    """The record of a press that could not be set up."""
    return PressRecord(
        press=job.press.name,
        indenter=job.setup.indenter.name,
        place=job.place,
        mesh=job.setup.mesh,
        surface=ContactFaceMesh.from_mesh(job.setup.mesh),
        gel_from_press=job.gel_from_press,
        thickness_mm=math.nan,
        step_count=len(job.press.waypoints()),
        cause=cause,
        device=device,
        **_stacked([], job.setup.mesh.node_count),
    )


DEEPEST = 0.8
"""Deepest press as a part of the gel's thickness; ``depth_fraction`` ends there, too."""


@dataclass(frozen=True, eq=False)
class PressJob:
    """One indenter in one place on one gel."""

    press: StandardPress
    place: tuple[float, float]
    """Place as in ``StandardPress.places``."""
    setup: PressSetup
    """The gel on its mesh, the tool, and the physics between them."""
    gel_from_press: np.ndarray
    """Origin on the contact face, z along its normal, [7]."""
    layers: tuple[Material, ...]
    """Material of each layer, ``REFERENCE_PA`` that of layer 0."""

    @cached_property
    def batch_key(self) -> str:
        """Equal for jobs that can be environments of one batch."""
        p = self.press
        path = [dataclasses.astuple(point) for point in p.waypoints()]
        rule = [p.depth_fraction, p.depth_mm, min(p.depth_limit_mm, 1e3), p.shear_fraction]
        told = [path, rule, p.twist_deg, self.setup.friction_coefficient, repr(self.layers)]
        return hashlib.sha256((self.setup.batch_key + json.dumps(told)).encode()).hexdigest()

    @cached_property
    def key(self) -> str:
        """Equal for jobs whose results are, up to the modulus."""
        digest = hashlib.sha256(self.batch_key.encode())
        digest.update(self.setup.mesh.nodes_m.tobytes())
        digest.update(self.gel_from_press.tobytes())
        return digest.hexdigest()


def press_jobs(press: StandardPress, parameters: FamilyParameters) -> list[PressJob]:
    """The simulations of a standard press on a design: each indenter in each place.

    Raises InputError for a place beside the pad or too near to its edge to be meshed, and for a
    depth of which the gel would leave nothing.
    """
    pad, grid = parameters.pad(), parameters.grid()
    layers = parameters.layer_materials()
    jobs = []
    depth_mm, deepest_mm = press.full_depth_mm(pad.thickness_mm), DEEPEST * pad.thickness_mm
    if depth_mm > deepest_mm:
        raise InputError(
            f"{depth_mm:.3g} mm is too deep for a gel of {pad.thickness_mm:.3g} mm; at most "
            f"{deepest_mm:.3g} mm, or depth_fraction in place of depth_mm"
        )
    one_pa = REFERENCE_PA / layers[0].young_modulus_pa
    materials = tuple(Material(one_pa * m.young_modulus_pa, m.poisson_ratio) for m in layers)
    path = PressPath(depth_mm, (press.shear_fraction * depth_mm, 0.0), press.twist_deg)
    for text in press.indenters:
        for place in press.places:
            at = place_mm(grid, place)
            setup = PressSetup.on_pad(
                pad,
                partial(layered_material, materials),
                parse_indenter(text),
                at,
                path,
                poisson_ratio=layers[0].poisson_ratio,
                friction_coefficient=layers[-1].friction_coefficient,
                physics=press.physics,
                in_batch=True,
            )
            jobs.append(PressJob(press, place, setup, face_frame(pad, at), materials))
    return jobs


def place_mm(grid: PixelGrid, place: tuple[float, float]) -> tuple[float, float]:
    """Gel xy [mm] of a place in parts of half of the camera's view; (0, 0) is its centre."""
    half = 0.5 * np.array([grid.width_px - 1, grid.height_px - 1])
    x, y = grid.gel_from_pixel(half + half * np.array(place))
    return float(x), float(y)


_PX = 161
_MARGIN = 1.3
_MEASURED = ("sphere", "cylinder", "box", "roller")
"""Tools with one contact without holes."""


def measured_contact_mm(
    env: PressEnv, indenter: Indenter, gel_from_press: np.ndarray
) -> np.ndarray | None:
    """Radius of the disc of the contact's area in each environment [mm], [env_count]; None of tools
    without one.

    Of the fine surface (``FineSurface``), seen along the presses, whose frames are
    ``gel_from_press``, [env_count, 7].
    """
    if indenter.name.partition(":")[0] not in _MEASURED:
        return None
    shape = indenter.shape
    if isinstance(shape, Ball):
        reach_m = shape.radius_m
    else:
        reach_m = float(np.abs(shape.vertices_m[:, :2]).max())
    grid = PixelGrid(_PX, _PX, *2 * [2 * _MARGIN * reach_m * 1e3 / (_PX - 1)])
    return 1e3 * contact_radii_m(env, indenter, grid, gel_from_press)
