# SPDX-License-Identifier: Apache-2.0
"""Stages 2 and 3 of an iteration: pairs that may meet on the way ahead, and how far it is free.

Pairs are searched for only where those that are known may no longer be all (``kept_pairs``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from taccel_lab.ipc.affine.bent_step import LARGEST_TURN
from taccel_lab.ipc.contact.step_limit import SLACKNESS, limit_checks
from taccel_lab.ipc.device.ragged_lists import ListRoom, overflows
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})


_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))
_CHORD_SHARE = SLACKNESS / 4
"""Part of a gap by which nodes may leave their chords: both sides do, and half of what CCD leaves
remains."""


@wp.kernel
def _count_search_kernel(
    searched: wp.array(dtype=wp.int32),
    node_faces: ListRoom,
    edge_edges: ListRoom,
    trees: ListRoom,
    covered: wp.array(dtype=wp.float64),
    p: Progress,
):
    """Count a search; stop environments whose pairs did not fit, or that need trees: the host makes
    room."""
    env = wp.tid()
    if searched[env] == 0:
        return
    p.counts.searches[env] += 1
    # All, as a list that was too short is emptied.
    first = overflows(env, node_faces)
    second = overflows(env, edge_edges)
    third = overflows(env, trees)
    if first or second or third:
        covered[env] = wp.float64(0.0)
        stop(env, _CONTACT_OVERFLOW, p)


def find_pairs(run: StepLaunches, mask: EnvMask, poses: wp.array, reach: wp.array) -> None:
    """Pairs within ``reach`` [m] of the way of ``displacements`` and of the frames to ``poses``, in
    the environments of ``mask``."""
    s, state = run.s, run.state

    def count() -> None:
        # Where gels touch no gels, the first stands for the third as well.
        rooms = [part.room for part in s.candidates.lists]
        rooms += rooms[: 3 - len(rooms)]
        run.decide(_count_search_kernel, s.pairs.stale, *rooms, s.pairs.covered)

    s.pairs.cover(mask, state.positions, s.displacements, state.poses, poses, reach, count)


@wp.func
def longest(env: int, p: Progress) -> wp.float64:
    """Fraction of the direction that turns no affine body by more than ``LARGEST_TURN``, up to
    1."""
    bend = wp.max(p.clearance.bend[env], wp.float64(1.0e-300))
    return wp.min(wp.float64(1.0), wp.float64(LARGEST_TURN) / bend)


@wp.func
def safe_fraction(env: int, gap: wp.float64, p: Progress) -> wp.float64:
    """Fraction of the direction along which what turns leaves the chords that CCD checks by less
    than CCD leaves of the smallest ``gap`` [m].

    The search reaches as far beyond ``dhat`` as any node leaves its chord: what frames carry, by
    ``margin``, and affine bodies, by the rest, which falls with the square of the fraction.
    """
    spare = wp.float64(_CHORD_SHARE) * gap - (p.clearance.margin[env] - p.rules.dhat)
    bent = p.clearance.reach[env] - p.clearance.margin[env]
    if spare < wp.float64(0.0):
        return wp.float64(0.0)
    if bent <= spare:
        return wp.float64(1.0)
    return longest(env, p) * wp.sqrt(spare / bent)


@wp.kernel
def _choose_kernel(
    mask: wp.array(dtype=wp.int32),
    travels: wp.array(dtype=wp.float64),
    gap_limit: wp.float64,
    p: Progress,
):
    """A way of less than half of the smallest gap meets nothing; ``min_distance`` knows no gap
    above ``gap_limit``."""
    env = wp.tid()
    p.clearance.near[env] = 0
    if mask[env] == 0:
        return
    p.clearance.limit[env] = longest(env, p)
    gap = wp.min(p.balance.min_distance[env], gap_limit)
    p.clearance.safe[env] = safe_fraction(env, gap, p)
    if not (wp.float64(2.0) * travels[env] < gap):
        p.clearance.near[env] = 1
        p.counts.ccd_passes[env] += 1


def limit_step(
    run: StepLaunches,
    mask: EnvMask,
    gaps_known: bool = True,
    beside: Sequence[Callable[[], None]] = (),
) -> None:
    """``limit`` of the environments of ``mask``: the fraction of ``displacements`` that is free of
    collisions, up to the ``longest`` that may be taken. ``find_pairs`` has been there.
    ``gaps_known``: whether ``min_distance`` is that of the positions. ``beside``: what else may be
    launched meanwhile."""
    s, p = run.s, run.p
    gap_limit = s.shortest_range_m if gaps_known else 0.0
    run.decide(_choose_kernel, mask, s.pairs.travels, gap_limit)
    x, displacements = run.state.positions, s.displacements
    checks = limit_checks(
        run.model, run.those(p.clearance.near), s.candidates, x, displacements, p.clearance.limit
    )
    run.together([*checks, *beside])
