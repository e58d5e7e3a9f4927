# SPDX-License-Identifier: Apache-2.0
"""Reports are read once, and say the same on the device and on the host; steps of some
environments, and steps that are taken again to other targets."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.scene import Ball, KinematicBody, TimeStepping
from taccel_lab.solvers import EnvStatus, SolverIPC, StepReport
from taccel_lab.solvers.step_report import ReportBlock
from tests.solvers.steps import Begun, assert_same, begun, left, stepped
from tests.support.blocks import block_mesh, everywhere, pose, scene

MESH = block_mesh((4, 4, 2), (5e-3, 5e-3, 2e-3))
NAMES = [field.name for field in fields(StepReport) if field.name != "seconds"]


def ball_at(*heights: float) -> np.ndarray:
    return np.stack([pose(0, 0, z)[None] for z in heights])


def made(env_count: int = 2, **options: object) -> Begun:
    model = scene(MESH, KinematicBody(Ball(1.5e-3)), env_count=env_count).finalize()
    return begun(model, ball_at(*[1.55e-3] * env_count), **options)


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[ReportBlock]:
    found: list[ReportBlock] = []
    read = ReportBlock.read

    def counted(block: ReportBlock) -> dict[str, np.ndarray]:
        found.append(block)
        return read(block)

    monkeypatch.setattr(ReportBlock, "read", counted)
    return found


def test_a_step_reads_its_report_once(reads: list[ReportBlock]) -> None:
    solver, state = made()
    reports = [stepped(solver, state, ball_at(1.45e-3, 1.4e-3 - 1e-5 * i)) for i in range(3)]
    assert reports[0].seconds > 0
    arrays = [report.on("cpu") for report in reports]
    # A later step leaves the arrays of an earlier report as they are.
    forces = [float(found["contact_force_n"].numpy()[1]) for found in arrays]
    assert forces[0] < forces[1] < forces[2]
    assert [report.contact_force_n[1] for report in reports] == forces
    for report, found in zip(reports, arrays, strict=True):
        assert set(found) == set(NAMES)
        for name in NAMES:
            np.testing.assert_array_equal(found[name].numpy(), getattr(report, name))
    assert len(reads) == 3
    np.testing.assert_array_equal(reports[0].substeps, [1, 1])
    # It can be kept.
    report = stepped(solver, state, ball_at(1.45e-3, 1.4e-3))
    kept = pickle.loads(pickle.dumps(report))
    for name in [*NAMES, "seconds"]:
        np.testing.assert_array_equal(getattr(kept, name), getattr(report, name))


def test_torch_shares_the_memory() -> None:
    report = stepped(*made(), ball_at(1.45e-3, 1.4e-3))
    found = report.on("cpu")
    tensor = torch.from_dlpack(found["residual_n"])
    assert tensor.data_ptr() == found["residual_n"].ptr == report.on("cpu")["residual_n"].ptr
    np.testing.assert_array_equal(tensor.numpy(), report.residual_n)
    done = wp.to_torch(found["status"]) == int(EnvStatus.CONVERGED)
    assert done.all() and done.dtype == torch.bool


def test_forces_of_what_failed_leave_the_report_as_it_is() -> None:
    """They are found once it is read, with the gap of where the environment is back again."""
    solver, state = made()
    stepped(solver, state, ball_at(1.45e-3, 1.4e-3))
    config = replace(solver.config, max_newton_iterations=1, max_substep_halvings=0)
    report = SolverIPC(solver.model, config).step(state, ball_at(1.55e-3, 1.55e-3))
    assert not report.converged.any()
    for name, array in report.on("cpu").items():
        np.testing.assert_array_equal(array.numpy(), getattr(report, name))


def test_a_step_in_parts_says_the_same_on_the_device() -> None:
    """Environment 1 needs halves: its report is put together on the host."""
    solver, state = made(max_newton_iterations=9)
    solver.step(state, ball_at(1.45e-3, 1.45e-3))
    report = solver.step(state, ball_at(1.449e-3, 0.9e-3))
    assert report.substeps[0] == 1 < report.substeps[1]
    for name, array in report.on("cpu").items():
        np.testing.assert_array_equal(array.numpy(), getattr(report, name))


@pytest.mark.parametrize("kind", ["torch", "warp bool", "warp int32"])
def test_a_mask_of_the_device_resets_as_one_of_the_host(kind: str) -> None:
    """Also the search for overlaps: environment 1 starts in the gel."""
    mask = np.array([False, True, True])
    given = {
        "torch": torch.from_numpy(mask),
        "warp bool": wp.array(mask, dtype=wp.bool, device="cpu"),
        "warp int32": wp.array(mask.astype(np.int32), dtype=wp.int32, device="cpu"),
    }[kind]
    ends = []
    for chosen in (mask, given):
        solver, state = made(3)
        stepped(solver, state, ball_at(1.45e-3, 1.4e-3, 1.45e-3))
        solver.reset(state, chosen, ball_at(0, 1.3e-3, 1.56e-3))
        report = solver.step(state, ball_at(1.44e-3, 1.29e-3, 1.5e-3))
        assert report.status.tolist() == [1, EnvStatus.OVERLAP, 1]
        assert report.on("cpu")["status"].numpy().tolist() == report.status.tolist()
        solver.reset(state, chosen, ball_at(0, 1.55e-3, 1.56e-3))
        stepped(solver, state, ball_at(1.44e-3, 1.5e-3, 1.5e-3))
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(*ends)
    with pytest.raises(InputError, match=r"bool or int32 of shape \[3\] on cpu, got bool of shape"):
        solver.reset(state, torch.ones(2, dtype=torch.bool))


# Some environments, and again ---------------------------------------------------------------------

RADIUS = 2e-3


def at(x: float, z: float, env_count: int = 1) -> np.ndarray:
    return everywhere(env_count, pose(x, 0, RADIUS + z))


def pressed(env_count: int = 1) -> Begun:
    mesh = block_mesh((6, 6, 2), (4e-3, 4e-3, 1e-3))
    model = scene(mesh, KinematicBody(Ball(RADIUS), 0.5), env_count=env_count).finalize()
    solver, state = begun(model, at(0, 5e-5, env_count), relative_tolerance=1e-6)
    stepped(solver, state, at(0, -1e-4, env_count))
    return solver, state


def test_a_step_taken_again_is_the_step_to_the_other_target() -> None:
    solver, state = pressed()
    soft, start, other = slice(0, solver.model.soft_count), state.copy(), at(3e-5, -1.02e-4)

    def forces() -> np.ndarray:
        parts = (solver.contact_gradient, solver.friction_gradient)
        return np.stack([part.numpy()[0, soft].sum(axis=0) for part in parts])

    first = stepped(solver, state, at(3e-5, -1.0e-4))
    again = stepped(solver, state, other, again=True)
    assert again.newton_iterations[0] < first.newton_iterations[0]
    found, x, v = forces(), state.positions.numpy(), state.velocities.numpy()
    stepped(solver, start, other)
    expected = forces()
    size = float(np.linalg.norm(expected))
    assert np.abs(expected[1, 0]) > 0.1 * size, "it is sheared"
    np.testing.assert_allclose(found, expected, atol=1e-4 * size)
    np.testing.assert_allclose(x, start.positions.numpy(), atol=2e-9)
    np.testing.assert_allclose(v, start.velocities.numpy(), atol=1e-4 * float(np.abs(v).max()))
    # As a step of its own, in which nothing moves, it keeps what friction holds.
    solver.step(start, other)
    np.testing.assert_allclose(forces(), expected, atol=1e-4 * size)


def test_environments_that_are_not_asked_for_keep_every_bit() -> None:
    solver, state = pressed(2)
    stepped(solver, state, at(3e-5, -1e-4, 2))

    def second() -> list[np.ndarray]:
        return [*left(solver, state, 1), state.poses.numpy()[1].copy()]

    before, first = second(), np.array([True, False])
    for again in (False, True):
        report = solver.step(state, at(6e-5, -1.1e-4, 2), who=first, again=again)
        assert report.status.tolist() == [EnvStatus.CONVERGED, EnvStatus.SKIPPED]
        assert_same(second(), before)
    stepped(solver, state, at(3e-5, -1e-4, 2))


def test_a_mask_may_be_written_anew_in_place() -> None:
    solver, state = pressed(2)
    who = np.array([True, False])
    for asked in ([True, False], [False, True], [True, True]):
        who[:] = asked
        report = solver.step(state, at(3e-5, -1e-4, 2), who=who)
        assert (report.status == EnvStatus.CONVERGED).tolist() == asked


def test_what_has_inertia_is_not_taken_again() -> None:
    time = TimeStepping(dt_s=0.01, quasi_static=False)
    solver, state = begun(scene(MESH, KinematicBody(Ball(RADIUS)), time=time), at(0, 1e-4))
    solver.step(state)
    with pytest.raises(InputError, match="quasi-static"):
        solver.step(state, again=True)
