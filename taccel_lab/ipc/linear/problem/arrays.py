# SPDX-License-Identifier: Apache-2.0
"""The arrays of one Newton system an environment, as assembly and solvers share them.

Beside the fixed pattern of the matrix stand its extra blocks, of contact between two free bodies,
and what a solve did, which the host reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import warp as wp

from taccel_lab.ipc.device.ragged_lists import MOST_ENTRIES, GrowingList
from taccel_lab.ipc.device.sums import ReproducibleSums
from taccel_lab.model.launches import Scratch
from taccel_lab.model.matrix_pattern import BlockPattern


class ExtraBlocks(GrowingList):
    """A list of blocks (row > column) per environment; several entries of one place add up.

    A count beyond the room means that blocks were lost: solvers read no further than the list goes,
    and whoever assembled them has to notice.
    """

    columns: ClassVar = {"places": wp.vec2i, "values": wp.mat33d}
    # Solvers count the numbers of the blocks, and copies of them that are padded (``extra_rows``).
    most_entries: ClassVar = MOST_ENTRIES // 32
    places: wp.array
    """(row, column), shape [capacity]."""
    values: wp.array
    """Blocks [N/m], shape [capacity]."""

    def __init__(
        self, env_count: int, device: wp.Device, room: int = 1, limit: int = 1 << 24
    ) -> None:
        super().__init__(env_count, device, room, limit)

    def clear(self, active: wp.array | None = None) -> None:
        """Forget the blocks of active environments (int32, [env_count]); of all when None."""
        if active is None:
            self.counts.zero_()
        else:
            super().clear(active)


class LinearProblem:
    """H p = rhs in each environment, what is asked of its solution and what became of it."""

    def __init__(
        self,
        pattern: BlockPattern,
        env_count: int,
        device: wp.Device,
        extra_room: int = 1,
        scratch: Scratch | None = None,
        positions_m: np.ndarray | None = None,
        held: np.ndarray | None = None,
        in_any_order: bool = False,
    ) -> None:
        self.in_any_order = in_any_order
        """Whether solutions are the same bits in whatever order blocks and forces were added."""
        self.positions_m = positions_m
        """Where the rows are at rest [m], shape [free_count, 3], for methods that ask."""
        self.held = np.zeros(pattern.free_count, dtype=bool) if held is None else held
        """Whether a row shares an element with a node that is no unknown, bool, [free_count]."""
        self.scratch = scratch or Scratch()
        """Where solvers keep what they need during a solve alone."""
        self.pattern = pattern
        self.env_count = env_count
        self.device = device
        self.values = wp.zeros((env_count, pattern.block_count), dtype=wp.mat33d, device=device)
        """Blocks of the lower triangle [N/m], shape [env_count, block_count]."""
        self.extra = ExtraBlocks(env_count, device, extra_room)
        """What does not fit the pattern."""
        shape = (env_count, pattern.free_count)
        self.rhs = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Right-hand sides [N], shape [env_count, free_count]."""
        blocks = (env_count, pattern.block_count)
        self.block_sums = ReproducibleSums(blocks, device, in_any_order)
        """How what comes in any order is added to ``values`` and ``extra``."""
        self.rhs_sums = ReproducibleSums(shape, device, in_any_order)
        """The same of ``rhs``."""
        self.solution = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Solutions [m], shape [env_count, free_count]; zero where not active."""
        self.tolerances = wp.full(env_count, 1e-6, dtype=wp.float64, device=device)
        """||rhs - H p|| / ||rhs|| to reach, written by the caller, shape [env_count]."""
        self.iterations = wp.zeros(env_count, dtype=wp.int32, device=device)
        """CG iterations of the last solve (1 for a direct one), 0 where not active, [env_count]."""
        self.breakdown = wp.zeros(env_count, dtype=wp.int32, device=device)
        """1 where the matrix of the last solve is not positive definite or a number is not finite.
        The solution then has modes of negative curvature turned (``turned``): it descends, or is
        zero. [env_count]."""
        self.residuals = wp.zeros(env_count, dtype=wp.float64, device=device)
        self.renewed = wp.full(env_count, 1, dtype=wp.int32, device=device)
        """Whether the next solve makes anew what part of a preconditioner takes long, int32,
        [env_count]; where 0, that of the last solve serves once more."""
        """||rhs - H p|| / ||rhs|| of the last solution, 0 when rhs is 0, [env_count]."""

    @property
    def shape(self) -> tuple[int, int]:
        """(env_count, free_count)."""
        return self.env_count, self.pattern.free_count


@dataclass(frozen=True)
class LinearReport:
    """Arrays of shape [env_count]; environments that were not active read 0, 0 and False."""

    iterations: np.ndarray
    """CG iterations, int64."""
    relative_residual: np.ndarray
    """True residual ||rhs - H p|| / ||rhs|| of the solution, float64, but for what rounding adds
    where the matrix is rounded and not verified (``VERIFY_BELOW``); 0 when rhs is 0, and where a
    factorisation of the whole matrix gave the solution and nobody measured it."""
    breakdown: np.ndarray
    """Whether the matrix is not positive definite or a number is not finite, see ``LinearProblem``;
    bool."""

    @classmethod
    def read(cls, problem: LinearProblem) -> LinearReport:
        """Copy the figures of the last solve to the host; waits for the device."""
        return cls(
            iterations=problem.iterations.numpy().astype(np.int64),
            relative_residual=problem.residuals.numpy().copy(),
            breakdown=problem.breakdown.numpy() != 0,
        )
