# SPDX-License-Identifier: Apache-2.0
"""Terms of the energy: what each has to offer, and their sum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.ragged_lists import ListRoom
from taccel_lab.ipc.device.sums import (
    BLOCK_THREADS,
    add_row_sums,
    block_total,
    lane_list_sum,
    lane_sum,
)
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


class EnergyTerm:
    """A term of the energy whose sum may also be asked for by the host."""

    energies: wp.array
    """Energy of each item [J], float64, shape [env_count, item_count]; or those of a list."""
    room: ListRoom | None = None
    """Where the items of each environment are, for those of a list."""

    def write_energies(self, active: EnvMask, at: Any, /) -> None:
        """Fill ``energies`` of active environments."""
        raise NotImplementedError

    def add_energy(self, active: EnvMask, positions: Any, totals: wp.array) -> None:
        """Add the energy [J] to ``totals``, float64, shape [env_count], where active."""
        self.write_energies(active, positions)
        add_row_sums(active, self.energies, self.room, totals)

    def energy(self, active: EnvMask, positions: Any) -> np.ndarray:
        """Energy [J] at positions (or, of friction, after a motion), shape [env_count]; zero where
        not active."""
        totals = wp.zeros(len(active), dtype=wp.float64, device=active.device)
        self.add_energy(active, positions, totals)
        return totals.numpy()


class Potential(EnergyTerm):
    """A term that depends on positions alone once a step has begun."""

    def add_gradient(self, active: EnvMask, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N], shape [env_count, node_count]."""
        raise NotImplementedError

    def add_hessian(
        self, active: EnvMask, positions: wp.array, system: NewtonSystem, psd_modes: wp.array
    ) -> None:
        """Add d^2 energy / dx^2 [N/m] to the Newton system, projected where ``psd_modes``
        [env_count], one of PSD_*, says so."""
        raise NotImplementedError


def share_buffer(terms: Sequence[EnergyTerm], env_count: int, device: wp.Device) -> wp.array:
    """Energies of all terms side by side, float64, [env_count, all items]: one sum for all."""
    widths = [term.energies.shape[1] for term in terms]
    buffer = wp.zeros((env_count, max(sum(widths), 1)), dtype=wp.float64, device=device)
    start = 0
    for term, width in zip(terms, widths, strict=True):
        term.energies = buffer[:, start : start + width]
        start += width
    return buffer


@wp.struct
class WrittenEnergies:
    """Energies [J] of all items, as the terms have written them.

    fixed: those of ``share_buffer``, [env_count, all items].
    contact, friction: those of lists; without friction empty.
    """

    fixed: wp.array2d(dtype=wp.float64)
    contact: wp.array(dtype=wp.float64)
    contact_room: ListRoom
    friction: wp.array(dtype=wp.float64)
    friction_room: ListRoom


@wp.func
def block_base(env: int, lane: int, e: WrittenEnergies) -> wp.float64:
    """Energy of an environment without friction [J], by its block."""
    mine = lane_sum(env, lane, e.fixed, e.fixed.shape[1])
    mine += lane_list_sum(env, lane, e.contact, e.contact_room)
    return block_total(mine)


@wp.func
def block_friction(env: int, lane: int, e: WrittenEnergies) -> wp.float64:
    """Energy of friction of an environment [J], by its block."""
    if e.friction.shape[0] == 0:
        return wp.float64(0.0)
    return block_total(lane_list_sum(env, lane, e.friction, e.friction_room))


@wp.kernel
def _energies_kernel(
    active: Envs,
    e: WrittenEnergies,
    base: wp.array(dtype=wp.float64),
    totals: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    without = block_base(env, lane, e)
    friction = block_friction(env, lane, e)
    if lane == 0:
        base[env] = without
        totals[env] = without + friction


def written_energies(
    fixed: wp.array, contact: EnergyTerm, friction: EnergyTerm | None
) -> WrittenEnergies:
    """What terms write, for kernels; ``fixed``: of ``share_buffer``."""
    written = WrittenEnergies()
    written.fixed, written.contact, written.contact_room = fixed, contact.energies, contact.room
    if friction is not None:
        written.friction, written.friction_room = friction.energies, friction.room
    return written


def sum_energies(
    active: EnvMask, written: WrittenEnergies, base: wp.array, totals: wp.array
) -> None:
    """Sum the energies that terms have written: without friction to ``base``, with it to ``totals``
    [J], [env_count]."""
    launch_blocks(_energies_kernel, len(active), active, written, base, totals)
