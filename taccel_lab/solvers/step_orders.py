# SPDX-License-Identifier: Apache-2.0
"""What the host tells a step: who takes it, and to which targets, with one copy to the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
import warp as wp

from taccel_lab.model.launches import part_of


class StepOrders:
    """Masks and targets on one block of memory; on a GPU another one of the host holds the same."""

    MASKS: ClassVar = ("who", "reads", "writes", "again", "ahead")
    """See ``env_progress.Roster``."""

    def __init__(self, env_count: int, kinematic_count: int, device: wp.Device) -> None:
        mask_numbers = -(-len(self.MASKS) * env_count // 2)
        count = mask_numbers + 7 * env_count * kinematic_count
        self._device = wp.zeros(count, dtype=wp.float64, device=device)
        self._host = self._device
        if device.is_cuda:
            self._host = wp.zeros(count, dtype=wp.float64, device="cpu", pinned=True)
        numbers = self._host.numpy()
        rows = numbers[:mask_numbers].view(np.int32)
        rows = rows[: len(self.MASKS) * env_count].reshape(len(self.MASKS), env_count)
        self._rows: dict[str, np.ndarray] = dict(zip(self.MASKS, rows, strict=True))
        self._targets = numbers[mask_numbers:].reshape(env_count, kinematic_count, 7)
        self._ends = {"masks": (0, mask_numbers), "targets": (mask_numbers, count)}
        self._waiting: set[str] = set()
        """What the device has not been told yet, of ``_ends``."""
        self._ahead: Callable[[wp.array], None] | None = None
        self.looks_ahead = False
        """Whether anybody has ever said where a step may end."""
        self._known: dict[str, np.ndarray] = {}
        """Masks of the latest ``tell``, by name."""
        self.masks = {
            name: part_of(self._device, 4 * env_count * i, wp.int32, (env_count,))
            for i, name in enumerate(self.MASKS)
        }
        """Masks on the device, int32, [env_count], by name."""
        shape = (env_count, kinematic_count)
        self.targets = part_of(self._device, 8 * mask_numbers, wp.transformd, shape)
        """Targets on the device, transformd, [env_count, kinematic_count]."""

    def tell(self, name: str, mask: np.ndarray) -> None:
        """Say who is in a mask (bool, [env_count]), which nobody changes afterwards."""
        if self._known.get(name) is mask:
            return
        self._known[name] = mask
        row = self._rows[name]
        if (row != mask).any():
            row[:] = mask
            self._waiting.add("masks")

    def aim(self, targets: np.ndarray | wp.array) -> None:
        """Set the targets: poses of the host, float64, [env_count, kinematic_count, 7], or of the
        device, transformd."""
        self._waiting.discard("targets")
        if isinstance(targets, wp.array):
            wp.copy(self.targets, targets)
        else:
            self._targets[:] = targets
            self._waiting.add("targets")

    def look(self, ahead: Callable[[wp.array], None] | None) -> None:
        """Search from where ``ahead`` says, see ``SolverIPC.step``, in all steps from now on."""
        self._ahead = ahead
        self.looks_ahead |= ahead is not None
        self.tell("ahead", np.full(len(self._targets), ahead is not None))

    def send(self, places: wp.array | None = None) -> None:
        """Copy to the device what it has not been told, and have ``places`` written where a search
        is to start; does not wait for it."""
        if self._ahead is not None and places is not None:
            self._ahead(places)
        if self._host is not self._device and self._waiting:
            ends = [end for part in self._waiting for end in self._ends[part]]
            first, count = min(ends), max(ends) - min(ends)
            if count:
                wp.copy(self._device, self._host, first, first, count)
        self._waiting.clear()

    def repeat(self) -> None:
        """Tell all masks again: a copy may have been interrupted."""
        self._ahead = None
        self._known.clear()
        self._waiting.add("masks")
