# SPDX-License-Identifier: Apache-2.0
"""What a step did, per environment: numbers first. The host reads them once a step, as statuses
decide whether it is taken again in halves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.model.launches import part_of


class EnvStatus(IntEnum):
    """How a step ended in one environment."""

    RUNNING = 0
    CONVERGED = 1
    NO_CONVERGENCE = 2
    """The Newton iterations were used up."""
    LINE_SEARCH = 3
    """No step along the search direction lowered the energy."""
    NOT_A_NUMBER = 4
    """A position, residual or search direction was not finite."""
    FRICTION = 5
    """Re-freezing friction did not settle."""
    INVERSION = 6
    """An element was inverted before the step; or by it, in a material whose energy bears that."""
    CONTACT_OVERFLOW = 7
    """More contacts than ``SolverConfig.max_collisions``, or than there is memory for."""
    JOINT = 8
    """A joint stayed open by more than its tolerance."""
    TOUCHING = 9
    """Two surfaces touched or crossed before the step: no motion is free of collisions."""
    SKIPPED = 10
    """The environment was not asked for."""
    OVERLAP = 11
    """Bodies overlapped before the first step, see ``SolverIPC.step``."""
    IMPACT = 12
    """BDF2 met an impact: the solver takes the step again by implicit Euler at once."""
    STALLED = 13
    """Neither residual nor energy has fallen in ``env_phase.STALL_AFTER`` iterations."""
    BLOCKED = 14
    """The step failed, and its way leads a kinematic body through bonded faces of a gel, see
    ``ipc.contact.blocked_ways``; it is not tried in parts."""


_INTS = ("status", "newton_iterations", "cg_iterations", "friction_lags") + (
    "searches",
    "ccd_passes",
    "starts_tried",
    "starts_taken",
)
_FLOATS = ("residual_n", "residual_ratio", "contact_force_n", "min_distance_m") + (
    "joint_violation_m",
    "smallest_step",
)


class ReportBlock:
    """The figures of a report on the device, laid out so that one copy takes them all."""

    def __init__(self, rows: wp.array) -> None:
        """``rows``: float64, see ``zeros``."""
        self._rows = rows
        self._on_host = rows
        """Where ``read`` finds them; ``fetch`` makes it where a GPU writes by itself."""
        self.version = 0
        """Number of the figures on the device; a report's are there while it is the same."""

    @cached_property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays of shape [env_count] by name, float64 or int32, on the memory of the block."""
        floats = {name: self._rows[i] for i, name in enumerate(_FLOATS)}
        return floats | {name: self._int_row(i) for i, name in enumerate(_INTS)}

    def _int_row(self, index: int) -> wp.array:
        """One row of integers, of which two take the place of one of floating point numbers."""
        env_count = self._rows.shape[1]
        first = 8 * env_count * len(_FLOATS) + 4 * env_count * index
        return part_of(self._rows, first, wp.int32, (env_count,))

    @classmethod
    def zeros(cls, env_count: int, device: wp.Device) -> ReportBlock:
        """A block of zeros."""
        shape = (len(_FLOATS) + (len(_INTS) + 1) // 2, env_count)
        return cls(wp.zeros(shape, dtype=wp.float64, device=device))

    def copy(self) -> ReportBlock:
        """The same on memory of its own; does not wait for the device."""
        return ReportBlock(wp.clone(self._rows))

    def outdate(self) -> None:
        """Tell reports so far that the figures on the device are not theirs any more."""
        self.version += 1

    def fetch(self) -> None:
        """Begin to copy the figures to the host; does not wait for the device."""
        if self._rows.device.is_cuda:
            if self._on_host is self._rows:
                self._on_host = wp.empty_like(self._rows, device="cpu", pinned=True)
            wp.copy(self._on_host, self._rows)

    def read(self) -> dict[str, np.ndarray]:
        """All arrays as ``fetch`` found them, int64 or float64; waits for the device."""
        if self._rows.device.is_cuda:
            wp.synchronize_stream(self._rows.device)
        rows = self._on_host.numpy()
        ints = rows[len(_FLOATS) :].view(np.int32).reshape(-1, rows.shape[1]).astype(np.int64)
        floats = rows[: len(_FLOATS)].copy()
        found: dict[str, np.ndarray] = dict(zip(_INTS, ints, strict=False))
        return found | dict(zip(_FLOATS, floats, strict=True))


@dataclass(frozen=True, repr=False)
class StepReport:
    """Arrays by environment, of shape [env_count], unless said otherwise; ``on`` has them on the
    device."""

    status: np.ndarray
    """``EnvStatus``; environments that did not converge were rolled back."""
    newton_iterations: np.ndarray
    cg_iterations: np.ndarray
    """Sum over the step of the (batched) CG iterations while the environment was active."""
    friction_lags: np.ndarray
    """How often friction was frozen anew."""
    searches: np.ndarray
    """How often pairs were searched for; see ``ipc.broad_phase.kept_pairs``."""
    ccd_passes: np.ndarray
    """How many ways were checked for collisions; see ``solvers.limit_step``."""
    starts_tried: np.ndarray
    """Starts away from where the environment was; see ``solvers.start_step``."""
    starts_taken: np.ndarray
    residual_n: np.ndarray
    """Force residual at the end, friction re-frozen: the largest sum of magnitudes over the nodes
    of a body [N]."""
    residual_ratio: np.ndarray
    """The largest of a body over what is allowed that body, at most 1 where the step converged.
    ``SolverIPC.progress.balance`` has ``body_residuals`` and ``body_forces``,
    [env_count, body_count].
    """
    contact_force_n: np.ndarray
    """Sum of the magnitudes of the nodal contact forces on one side, the scale of the tolerance
    [N]."""
    min_distance_m: np.ndarray
    """Smallest gap of any pair within dhat [m]; infinite without contact."""
    smallest_step: np.ndarray
    """Smallest accepted step length of the line search."""
    joint_violation_m: np.ndarray
    """Largest violation of a joint's constraint [m]; 0 without joints."""
    substeps: np.ndarray
    """Parts the step was taken in: 1 unless it failed as a whole."""
    seconds: float
    """Wall time of the whole call, all environments."""

    @classmethod
    def of_block(cls, block: ReportBlock) -> StepReport:
        """Make the report of one attempt at a step from a ``block`` that was fetched; waits for the
        device."""
        found = block.read()
        substeps = (found["status"] == int(EnvStatus.CONVERGED)).astype(np.int64)
        report = cls(**found, substeps=substeps, seconds=0.0)
        object.__setattr__(report, "_block", block)
        object.__setattr__(report, "_version", block.version)
        return report

    def _kept(self) -> ReportBlock | None:
        """The figures on the device on memory of their own, if they are there still."""
        block: ReportBlock | None = self.__dict__.get("_block")
        if block is None or "_version" not in self.__dict__:
            return block
        kept = block.copy() if block.version == self.__dict__["_version"] else None
        object.__setattr__(self, "_block", kept)
        del self.__dict__["_version"]
        return kept

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def on(self, device: wp.Device | str) -> dict[str, wp.array]:
        """Return the arrays by name on a device, int32 or float64 of Warp; torch takes them through
        DLPack (``wp.to_torch``).

        Those of the latest step are on the device already, if it was taken at once. They are the
        report's from then on: the solver does not change them. Others come from the host.
        """
        block = self._kept()
        found: dict[str, wp.array] = {} if block is None else dict(block.arrays)
        for field in fields(self):
            if field.name != "seconds" and field.name not in found:
                value = getattr(self, field.name)
                dtype = wp.int32 if value.dtype.kind == "i" else wp.float64
                found[field.name] = wp.array(value, dtype=dtype, device=device)
        return {name: array.to(device) for name, array in found.items()}

    def timed(self, seconds: float) -> StepReport:
        """Return the report with the wall time of the whole call."""
        object.__setattr__(self, "seconds", seconds)
        return self

    def of(self, mask: np.ndarray) -> StepReport:
        """Return what it says of the environments of ``mask`` (bool, [env_count]) alone."""
        names = [field.name for field in fields(self) if field.name != "seconds"]
        return replace(self, **{name: getattr(self, name)[mask] for name in names})

    @property
    def converged(self) -> np.ndarray:
        """Whether each environment reached its tolerance."""
        return self.status == int(EnvStatus.CONVERGED)

    def retaken(self, later: StepReport, who: np.ndarray) -> StepReport:
        """Merge what ``later`` says of the environments ``who`` that took it again."""
        names = [field.name for field in fields(self) if field.name != "seconds"]
        return replace(
            self,
            **{name: np.where(who, getattr(later, name), getattr(self, name)) for name in names},
        )

    def followed_by(self, later: StepReport) -> StepReport:
        """Append ``later``, with the work of both; environments it skipped stay as they are."""

        skipped = later.status == EnvStatus.SKIPPED
        newest = ["status", *(name for name in _FLOATS if name != "smallest_step")]
        sums = [*_INTS[1:], "substeps", "seconds"]
        return replace(
            self,
            **{n: np.where(skipped, getattr(self, n), getattr(later, n)) for n in newest},
            **{n: getattr(self, n) + getattr(later, n) for n in sums},
            smallest_step=np.minimum(self.smallest_step, later.smallest_step),
        )

    def failures(self) -> dict[str, list[int]]:
        """Return the environments that failed, by cause."""
        causes: dict[str, list[int]] = {}
        for env in np.flatnonzero(~self.converged & (self.status != EnvStatus.SKIPPED)):
            causes.setdefault(EnvStatus(self.status[env]).name, []).append(int(env))
        return causes

    def __repr__(self) -> str:
        return f"step report: {self.summary()}"

    def summary(self) -> str:
        """Summarise in one line for a log."""
        good = int(self.converged.sum())
        line = (
            f"{good}/{len(self.status)} converged, "
            f"Newton {self.newton_iterations.max()}, CG {self.cg_iterations.max()}, "
            f"residual {self.residual_n.max():.2e} N of {self.contact_force_n.max():.3g} N, "
            f"min distance {self.min_distance_m.min() * 1e6:.2f} um, "
            f"smallest step {self.smallest_step.min():.2g}, {self.seconds:.2f} s"
        )
        if self.substeps.max() > 1:
            line += f", up to {self.substeps.max()} substeps"
        if causes := self.failures():
            line += "; " + ", ".join(f"{name}: {envs}" for name, envs in causes.items())
        return line

    def describe(self, environments: Sequence[int] | None = None) -> str:
        """Format a table for people, one line an environment: all of them, or those given."""
        columns = "env  status             Newton    CG  lags  parts   residual [N]  contact [N]"
        lines = [columns + "  gap [um]  smallest step"]
        for env in range(len(self.status)) if environments is None else environments:
            lines.append(
                f"{env:>3}  {EnvStatus(self.status[env]).name:<17}"
                f"{self.newton_iterations[env]:>8}{self.cg_iterations[env]:>6}"
                f"{self.friction_lags[env]:>6}{self.substeps[env]:>7}"
                f"{self.residual_n[env]:>15.2e}{self.contact_force_n[env]:>13.4g}"
                f"{self.min_distance_m[env] * 1e6:>10.3f}{self.smallest_step[env]:>15.3g}"
            )
        return "\n".join(lines)


def flagged_blocked(report: StepReport, blocked: Iterable[int]) -> StepReport:
    """Flag environments, by number, that failed as something held is in a body's way."""
    blocked = list(blocked)
    if not blocked:
        return report
    status = report.status.copy()
    status[blocked] = EnvStatus.BLOCKED
    return replace(report, status=status)
