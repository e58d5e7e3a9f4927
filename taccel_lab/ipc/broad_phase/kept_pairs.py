# SPDX-License-Identifier: Apache-2.0
"""Candidate pairs that are kept for as long as they are sure to be complete.

A search takes a multiple of what a Newton iteration moves things by as a skin on top of its reach
[Verlet 1967, Computer "Experiments" on Classical Fluids]. As long as no two nodes have moved
against each other by more than the skin since then, every pair that may come within reach is among
those that were found: two things cannot come nearer by more than the difference of their ways. The
differences of the ways of all nodes lie in a box, whose diagonal bounds them all, and which a
motion that all share does not enlarge. Environments are searched anew one by one, each when its
own pairs are no longer sure.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.device.sums import BLOCK_THREADS
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask, Envs, env_at, mask_like
from taccel_lab.model.env_rows import zero_rows
from taccel_lab.model.launches import launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})

_SKIN_OVER_WAY = 4.0
"""Skin over the way at hand: this number of steps of a steady motion share a search."""
_LARGEST_SKIN = 0.1
"""Largest skin over the median length of the edges. A peg between two gels takes 1.6 searches a
step with 0.1, and 8 % more candidates than without a skin; 2.6 with 0.05; 0.5 doubles the
candidates."""


@wp.func_native(native("kept_pairs", "block_diagonal"))
def block_diagonal(low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Diagonal of the box around the boxes of all threads of a block, the same in each thread."""
    ...


@wp.kernel
def _stray_kernel(
    active: Envs,
    nodes: wp.array(dtype=wp.int32),
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    reaches: wp.array(dtype=wp.float64),
    least_skin: wp.float64,
    largest_skins: wp.array(dtype=wp.float64),
    anchors: wp.array2d(dtype=wp.vec3d),
    covered: wp.array(dtype=wp.float64),
    travels: wp.array(dtype=wp.float64),
    stale: wp.array(dtype=wp.int32),
    any_stale: wp.array(dtype=wp.int32),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    # Before the barriers below: the first thread writes it after them.
    reached = covered[env]
    big = wp.float64(1.0e30)
    least = wp.vec3d(big, big, big)
    most = -least
    start_low = least
    start_high = most
    end_low = least
    end_high = most
    for i in range(lane, nodes.shape[0], wp.block_dim()):
        node = nodes[i]
        displacement = displacements[env, node]
        start = positions[env, node] - anchors[env, node]
        end = start + displacement
        least = wp.min(least, displacement)
        most = wp.max(most, displacement)
        start_low = wp.min(start_low, start)
        start_high = wp.max(start_high, start)
        end_low = wp.min(end_low, end)
        end_high = wp.max(end_high, end)
    apart = block_diagonal(least, most)
    strayed = wp.max(block_diagonal(start_low, start_high), block_diagonal(end_low, end_high))
    fresh = strayed + reaches[env] <= reached
    if lane == 0:
        travels[env] = apart
    if fresh:
        return
    # Where the way leads: the search holds the whole way there, and what comes next starts there.
    for i in range(lane, nodes.shape[0], wp.block_dim()):
        anchors[env, nodes[i]] = positions[env, nodes[i]] + displacements[env, nodes[i]]
    if lane == 0:
        largest_skin = largest_skins[env % largest_skins.shape[0]]
        skin = wp.clamp(wp.static(wp.float64(_SKIN_OVER_WAY)) * apart, least_skin, largest_skin)
        covered[env] = reaches[env] + skin
        stale[env] = 1
        any_stale[0] = 1


class KeptPairs:
    """Keeps ``candidates`` complete for the ways of a step."""

    def __init__(self, model: Model, candidates: Candidates, dhat_m: float) -> None:
        self.candidates = candidates
        self._model = model
        count, device = model.env_count, model.device
        surface = model.surface
        planes = np.flatnonzero(surface.plane_normals.numpy().any(axis=1))
        balls = np.flatnonzero(surface.node_is_ball.numpy())
        nodes = np.unique(np.concatenate([surface.faces.numpy().ravel(), planes, balls]))
        self._nodes = wp.array(nodes.astype(np.int32), dtype=wp.int32, device=device)
        self._least_skin_m = dhat_m
        skins = np.maximum(dhat_m, _LARGEST_SKIN * _median_edges_m(model))
        self._largest_skins = wp.array(skins, dtype=wp.float64, device=device)
        self._anchors = wp.zeros((count, model.node_count), dtype=wp.vec3d, device=device)
        self.covered = wp.zeros(count, dtype=wp.float64, device=device)
        """Distance from the ways of the last search up to which all pairs are listed [m]; 0 where
        nothing is sure."""
        self.travels = wp.zeros(count, dtype=wp.float64, device=device)
        """Bound of how far two nodes move against each other on the way at hand [m]."""
        self.stale = wp.zeros(count, dtype=wp.int32, device=device)
        """Mask of the environments that the last call searched."""
        self._any_stale = wp.zeros(1, dtype=wp.int32, device=device)
        """Zero but during a search."""

    def forget(self, mask: EnvMask) -> None:
        """Others have written to the lists of the environments of ``mask``: search anew there."""
        zero_rows(mask, self.covered)
        self._any_stale.zero_()

    def cover(
        self,
        active: EnvMask,
        positions: wp.array,
        displacements: wp.array,
        poses_start: wp.array,
        poses_end: wp.array,
        reaches: wp.array,
        searched: Callable[[], None],
    ) -> None:
        """Make sure that all pairs are listed that may come within ``reaches`` [m], [env_count], on
        the straight ways from ``positions`` along ``displacements`` [m] in the environments of
        ``active``; see ``Candidates.search``. ``searched``: called after a search, with the lists
        as they are then."""
        self.stale.zero_()
        inputs = [active, self._nodes, positions, displacements, reaches, self._least_skin_m]
        inputs += [self._largest_skins, self._anchors, self.covered, self.travels, self.stale]
        launch_blocks(_stray_kernel, len(active), *inputs, self._any_stale)

        def search() -> None:
            self.candidates.search(
                mask_like(active, self.stale),
                positions,
                displacements,
                poses_start,
                poses_end,
                self.covered,
            )
            searched()
            self._any_stale.zero_()

        wp.capture_if(self._any_stale, on_true=search)


def _median_edges_m(model: Model) -> np.ndarray:
    """Median length of the edges of all collision surfaces at rest [m], [rest_count]; 0 without
    any."""
    edges = model.surface.edges.numpy().reshape(-1, 2)
    rest = model.rest_positions.numpy()
    if len(edges) == 0:
        return np.zeros(len(rest))
    lengths = np.linalg.norm(rest[:, edges[:, 0]] - rest[:, edges[:, 1]], axis=2)
    return np.median(lengths, axis=1)
