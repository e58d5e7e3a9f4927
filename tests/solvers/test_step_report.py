# SPDX-License-Identifier: Apache-2.0
"""Reports stay on the device until they are read, and say the same there and on the host."""

from __future__ import annotations

import pickle
from dataclasses import fields

import numpy as np
import pytest
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.scene import Ball, KinematicBody
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC, StepReport
from taccel_lab.solvers.step_report import ReportBlock
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, pose, scene

MESH = block_mesh((4, 4, 2), (5e-3, 5e-3, 2e-3))
NAMES = [field.name for field in fields(StepReport) if field.name != "seconds"]


def ball_at(*heights: float) -> np.ndarray:
    return np.stack([pose(0, 0, z)[None] for z in heights])


def made(env_count: int = 2, **options: object) -> tuple[SolverIPC, State]:
    model = scene(MESH, KinematicBody(Ball(1.5e-3)), env_count=env_count).finalize()
    state = initial_state(model, ball_at(*[1.55e-3] * env_count))
    return SolverIPC(model, SolverConfig(**options)), state  # type: ignore[arg-type]


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[ReportBlock]:
    """Blocks that were copied to the host."""
    found: list[ReportBlock] = []
    read = ReportBlock.read

    def counted(block: ReportBlock) -> dict[str, np.ndarray]:
        found.append(block)
        return read(block)

    monkeypatch.setattr(ReportBlock, "read", counted)
    return found


def test_a_step_reads_statuses_only(reads: list[ReportBlock]) -> None:
    solver, state = made()
    reports = [solver.step(state, ball_at(1.45e-3, 1.4e-3 - 1e-5 * i)) for i in range(3)]
    assert all(report.converged.all() for report in reports)
    assert reports[0].seconds > 0
    arrays = [report.on("cpu") for report in reports]
    assert not reads
    # A later step leaves the arrays of an earlier report as they are.
    forces = [float(found["contact_force_n"].numpy()[1]) for found in arrays]
    assert forces[0] < forces[1] < forces[2]
    assert [report.contact_force_n[1] for report in reports] == forces
    assert len(reads) == 3
    for report, found in zip(reports, arrays, strict=True):
        assert set(found) == set(NAMES)
        for name in NAMES:
            np.testing.assert_array_equal(found[name].numpy(), getattr(report, name))
    assert len(reads) == 3, "each is read once"
    np.testing.assert_array_equal(reports[0].substeps, [1, 1])


def test_torch_shares_the_memory() -> None:
    solver, state = made()
    report = solver.step(state, ball_at(1.45e-3, 1.4e-3))
    found = report.on("cpu")
    tensor = torch.from_dlpack(found["residual_n"])
    assert tensor.data_ptr() == found["residual_n"].ptr == report.on("cpu")["residual_n"].ptr
    np.testing.assert_array_equal(tensor.numpy(), report.residual_n)
    done = wp.to_torch(found["status"]) == int(EnvStatus.CONVERGED)
    assert done.all() and done.dtype == torch.bool


def test_a_step_in_parts_says_the_same_on_the_device() -> None:
    """Environment 1 needs halves: its report is put together on the host."""
    solver, state = made(max_newton_iterations=9)
    solver.step(state, ball_at(1.45e-3, 1.45e-3))
    report = solver.step(state, ball_at(1.449e-3, 0.9e-3))
    assert report.substeps[0] == 1 < report.substeps[1]
    for name, array in report.on("cpu").items():
        np.testing.assert_array_equal(array.numpy(), getattr(report, name))


def test_a_report_can_be_kept(reads: list[ReportBlock]) -> None:
    solver, state = made()
    report = solver.step(state, ball_at(1.45e-3, 1.4e-3))
    kept = pickle.loads(pickle.dumps(report))
    assert len(reads) == 1
    for name in [*NAMES, "seconds"]:
        np.testing.assert_array_equal(getattr(kept, name), getattr(report, name))
    with pytest.raises(AttributeError, match="no 'force'"):
        report.force  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("kind", ["torch", "warp bool", "warp int32"])
def test_a_mask_of_the_device_resets_as_one_of_the_host(kind: str) -> None:
    """Also the search for overlaps: environment 1 starts in the gel."""
    mask = np.array([False, True, True])
    given = {
        "torch": torch.from_numpy(mask),
        "warp bool": wp.array(mask, dtype=wp.bool, device="cpu"),
        "warp int32": wp.array(mask.astype(np.int32), dtype=wp.int32, device="cpu"),
    }[kind]
    results = []
    for chosen in (mask, given):
        solver, state = made(3)
        assert solver.step(state, ball_at(1.45e-3, 1.4e-3, 1.45e-3)).converged.all()
        solver.reset(state, chosen, ball_at(0, 1.3e-3, 1.56e-3))
        report = solver.step(state, ball_at(1.44e-3, 1.29e-3, 1.5e-3))
        assert report.status.tolist() == [1, EnvStatus.OVERLAP, 1]
        assert report.on("cpu")["status"].numpy().tolist() == report.status.tolist()
        solver.reset(state, chosen, ball_at(0, 1.55e-3, 1.56e-3))
        assert solver.step(state, ball_at(1.44e-3, 1.5e-3, 1.5e-3)).converged.all()
        results.append(state.positions.numpy())
    np.testing.assert_array_equal(results[0], results[1])


def test_a_mask_of_another_shape_is_refused() -> None:
    solver, state = made()
    with pytest.raises(InputError, match=r"bool or int32 of shape \[2\] on cpu, got bool of shape"):
        solver.reset(state, torch.ones(3, dtype=torch.bool))
