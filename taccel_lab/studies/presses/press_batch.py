# SPDX-License-Identifier: Apache-2.0
"""Simulate presses: jobs of one connectivity, indenter and path are environments of one batch."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.model.embedding import rotate
from taccel_lab.outputs import Outputs
from taccel_lab.presses import PressEnv, layered_material, parse_indenter
from taccel_lab.scene import Material
from taccel_lab.signals import ContactFaceMesh
from taccel_lab.studies.presses.contact_size import measured_contact_mm
from taccel_lab.studies.presses.press_job import PressJob
from taccel_lab.studies.presses.press_record import PressRecord

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
    materials = [
        Material(REFERENCE_PA * ratio, nu)
        for ratio, nu in zip(first.modulus_ratios, first.poisson_ratios, strict=True)
    ]
    indenter = parse_indenter(first.indenter)
    frames = np.stack([job.gel_from_press for job in jobs])
    env = PressEnv(
        first.mesh,
        layered_material(materials, first.mesh),
        indenter,
        np.zeros((len(jobs), 2)),
        friction_coefficient=first.friction,
        rest_positions_m=np.stack([job.mesh.nodes_m for job in jobs]),
        gel_from_press=frames,
        physics=first.press.physics,
        device=device,
    )
    press = first.press
    thickness_mm = env.thickness_m * 1e3
    depth_mm = np.array([press.full_depth_mm(t) for t in thickness_mm])
    meshes = [env.nodal(job.mesh) for job in jobs]
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
            indenter=job.indenter,
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
        indenter=job.indenter,
        place=job.place,
        mesh=job.mesh,
        surface=ContactFaceMesh.from_mesh(job.mesh),
        gel_from_press=job.gel_from_press,
        thickness_mm=math.nan,
        step_count=len(job.press.waypoints()),
        cause=cause,
        device=device,
        **_stacked([], job.mesh.node_count),
    )
