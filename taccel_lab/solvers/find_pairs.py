# SPDX-License-Identifier: Apache-2.0
"""Stage 2 of an iteration: which pairs may meet on the way ahead.

They are searched for only where those that are known may no longer be all (``kept_pairs``).
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.ragged_lists import ListRoom, overflows
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))


@wp.kernel
def _count_search_kernel(
    searched: wp.array(dtype=wp.int32),
    node_faces: ListRoom,
    edge_edges: ListRoom,
    covered: wp.array(dtype=wp.float64),
    p: Progress,
):
    """Count a search; stop environments whose pairs did not fit: the host makes room."""
    env = wp.tid()
    if searched[env] == 0:
        return
    p.counts.searches[env] += 1
    # Both, as a list that was too short is emptied.
    first = overflows(env, node_faces)
    second = overflows(env, edge_edges)
    if first or second:
        covered[env] = wp.float64(0.0)
        stop(env, _CONTACT_OVERFLOW, p)


def find_pairs(run: StepLaunches, mask: wp.array, poses: wp.array, reach: wp.array) -> None:
    """Pairs within ``reach`` [m] of the way of ``displacements`` and of the frames to ``poses``, in
    the environments of ``mask``."""
    s, state = run.s, run.state

    def count() -> None:
        rooms = [part.room for part in s.candidates.lists]
        run.decide(_count_search_kernel, s.pairs.stale, *rooms, s.pairs.covered)

    s.pairs.cover(mask, state.positions, s.displacements, state.poses, poses, reach, count)
