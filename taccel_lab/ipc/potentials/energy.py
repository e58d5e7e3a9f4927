# SPDX-License-Identifier: Apache-2.0
"""Terms of the energy: what each has to offer, and their sum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.capacity import ListRoom
from taccel_lab.ipc.linear.scatter import NewtonSystem
from taccel_lab.ipc.reduce import (
    add_row_sums,
    block_total,
    lane_list_sum,
    lane_sum,
    launch_rows,
)

wp.set_module_options({"enable_backward": False})


class EnergyTerm:
    """A term of the energy whose sum may also be asked for by the host."""

    energies: wp.array
    """Energy of each item [J], float64, shape [env_count, item_count]; or those of a list."""
    room: ListRoom | None = None
    """Where the items of each environment are, for those of a list."""

    def write_energies(self, active: wp.array, at: Any, /) -> None:
        """Fill ``energies`` of active environments."""
        raise NotImplementedError

    def add_energy(self, active: wp.array, positions: Any, totals: wp.array) -> None:
        """Add the energy [J] to ``totals``, float64, shape [env_count], where active."""
        self.write_energies(active, positions)
        add_row_sums(active, self.energies, self.room, totals)

    def energy(self, active: wp.array, positions: Any) -> np.ndarray:
        """Energy [J] at positions (or, of friction, after a motion), shape [env_count]; zero where
        not active."""
        totals = wp.zeros(len(active), dtype=wp.float64, device=active.device)
        self.add_energy(active, positions, totals)
        return totals.numpy()


class Potential(EnergyTerm):
    """A term that depends on positions alone once a step has begun."""

    def add_gradient(self, active: wp.array, positions: wp.array, gradient: wp.array) -> None:
        """Add d energy / dx [N], shape [env_count, node_count]."""
        raise NotImplementedError

    def add_hessian(
        self, active: wp.array, positions: wp.array, system: NewtonSystem, psd_modes: wp.array
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


@wp.kernel
def _energies_kernel(
    active: wp.array(dtype=wp.int32),
    fixed: wp.array2d(dtype=wp.float64),
    contact: wp.array(dtype=wp.float64),
    contact_room: ListRoom,
    friction: wp.array(dtype=wp.float64),
    friction_room: ListRoom,
    base: wp.array(dtype=wp.float64),
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    if fixed:
        mine = lane_sum(env, lane, fixed, fixed.shape[1])
        mine += lane_list_sum(env, lane, contact, contact_room)
        all_of_base = block_total(mine)
        if lane == 0:
            base[env] = all_of_base
            totals[env] = all_of_base
    if friction:
        all_of_friction = block_total(lane_list_sum(env, lane, friction, friction_room))
        if lane == 0:
            totals[env] = base[env] + all_of_friction


def sum_energies(
    active: wp.array,
    fixed: wp.array | None,
    contact: EnergyTerm,
    friction: EnergyTerm | None,
    base: wp.array,
    totals: wp.array,
) -> None:
    """Sum the energies that terms have written: without friction to ``base``, with it to ``totals``
    [J], [env_count]. ``fixed``: those of ``share_buffer``; when None the base is taken as it is."""
    if fixed is None and friction is None:
        wp.copy(totals, base)
        return
    frozen = [friction.energies, friction.room] if friction else [None, ListRoom()]
    launch_rows(
        _energies_kernel, [active, fixed, contact.energies, contact.room, *frozen], [base, totals]
    )
