# SPDX-License-Identifier: Apache-2.0
"""Work of one or several thread blocks together: a barrier, and sums over their lanes.

``wp.tile_sum`` and reading its result back cost half a dozen barriers; a solver that lives in one
block waits for little else. These cost one each. A team is what works on one environment: one
block, or several that wait for each other at a counter in memory.

Blocks that wait for each other must all be resident on the GPU, and nobody else can know that they
are: another solver, in its own stream, may hold the multiprocessors that the last ones need.
So a team is made by the blocks themselves: those that run join it, until all are there or a short
time is over, and the work is shared among them. Blocks that come too late find the team closed, and
end. This needs neither cooperative launches nor clusters of blocks, and no particular chip.

On Warp's CPU backend a team is one block with one lane, or with several under
``wp.config.enable_cpu_blocks`` (the tests use that to catch races).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.model.launches import launch_blocks

wp.set_module_options({"enable_backward": False})

MAX_LANES = 512
"""Lanes of a block for which kernels are compiled (launch bounds)."""
MAX_BLOCKS = 64
"""Most blocks in a team."""


@wp.func_native("WP_TILE_SYNC();")
def block_barrier() -> None:
    """Wait for all lanes of the block; what they wrote before is visible to all of them after."""
    ...


@wp.func_native(native("block_ops", "anew"))
def anew(value: int) -> int:
    """The same value, of which the compiler does not know that it is.

    Addresses made from it are computed where they are used. In the loop of a solver it would keep
    all of them, some hundred, from before the loop; far more than there are registers, and every
    use of one would wait for memory.
    """
    ...


@wp.func_native(native("block_ops", "join_team"))
def join_team(env: int, blocks: int, patience: int, gates: wp.array(dtype=wp.int32)) -> wp.vec2i:
    """(number of this block in the team of an environment, blocks of the team) of at most
    ``blocks``; a size of 0 says that the block came too late and has to end. To be called once, by
    all lanes. ``patience``: for how many clock cycles the first waits for the others. ``gates``: 32
    counters an environment, of which three are used, to be zero at the start of the kernel."""
    ...


_WAIT = native("block_ops", "wait")


@wp.func_native(native("block_ops", "team_barrier", WAIT=_WAIT))
def team_barrier(env: int, blocks: int, gates: wp.array(dtype=wp.int32)) -> None:
    """Wait for all lanes of the team of an environment, of ``blocks`` that joined it."""
    ...


@wp.func_native(native("block_ops", "team_sum", WAIT=_WAIT))
def team_sum(
    value: wp.vec3d,
    env: int,
    block: int,
    blocks: int,
    lane: int,
    turn: int,
    gates: wp.array(dtype=wp.int32),
    scratch: wp.array(dtype=wp.vec3d),
) -> wp.vec3d:
    """Sum of ``value`` over all lanes of a team, the same bits in each; also a barrier.

    ``turn`` alternates between 0 and 1 from one call to the next: so the slowest lane can still
    read the last sum while the quickest writes the next. ``scratch``: two values a block on a GPU,
    a lane on the CPU.
    """
    ...


@dataclass(frozen=True)
class Team:
    """How many lanes work on one environment."""

    lanes: int
    """Lanes of a block; a multiple of 32 on a GPU."""
    blocks: int = 1
    """Most blocks that may join."""

    @property
    def size(self) -> int:
        """Lanes of the team."""
        return self.lanes * self.blocks


def team(
    device: wp.Device,
    env_count: int,
    tasks: int,
    lanes: int | None = None,
    blocks: int | None = None,
) -> Team:
    """Team for ``tasks`` lanes' worth of work an environment, as large as leaves one block to each
    multiprocessor. ``lanes`` of a block and ``blocks`` are chosen when left out."""
    if device.is_cpu:
        # One lane, unless tests ask for more and enable them.
        return Team(lanes if lanes and wp.config.enable_cpu_blocks else 1)
    processors = int(device.sm_count)
    if lanes is None:
        # A block of 512 fills the registers of a multiprocessor. Two of 256 hide each other's
        # barriers, unless their work is long beside these: then one has the cache for itself.
        alone = env_count <= processors or tasks > 4 * MAX_LANES
        most = MAX_LANES if alone else MAX_LANES // 2
        lanes = 32
        while lanes < min(tasks, most):
            lanes *= 2
    if blocks is not None:
        return Team(lanes, blocks)
    blocks = 1
    # Waiting for other blocks takes as long as two or three tasks.
    if tasks > 4 * lanes:
        most = min(MAX_BLOCKS, processors // env_count)
        while 2 * blocks <= most and blocks * lanes < tasks:
            blocks *= 2
    return Team(lanes, blocks)


def launch_team(kernel: wp.Kernel, env_count: int, team: Team, *arguments: Any) -> None:
    """Launch a kernel with a team an environment; it reads (block, lane) as its index, blocks of
    one environment side by side."""
    launch_blocks(kernel, env_count * team.blocks, *arguments, block_dim=team.lanes)
