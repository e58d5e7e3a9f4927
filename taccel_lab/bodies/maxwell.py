# SPDX-License-Identifier: Apache-2.0
"""Maxwell branches of a viscoelastic solid: a Prony series of its modulus, checked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from taccel_lab.errors import InputError

MOST_BRANCHES = 3
"""Most branches of a material: each is one more evaluation of all elements, and three span as many
decades of time."""


@dataclass(frozen=True, order=True)
class MaxwellBranch:
    """A spring and a dashpot in a row, beside the spring of the relaxed solid.

    With branches g_i, tau_i the modulus of a step of strain falls as E (1 + sum_i g_i
    exp(-t / tau_i)), E the modulus of the relaxed solid [the generalised Maxwell solid: Simo and
    Hughes 1998, Computational Inelasticity, 10.2]. Poisson's ratio is that of the solid at all
    times. A series whose moduli are shares p_i of the instantaneous modulus has
    g_i = p_i / (1 - sum p), and E is that modulus times 1 - sum p.
    """

    relative_modulus: float
    """Modulus of the spring over that of the relaxed solid, g."""
    time_s: float
    """Relaxation time tau [s]."""

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("relative_modulus", self.relative_modulus, 1e-6, 100.0),
            ("time_s", self.time_s, 1e-6, 1e6),
        ):
            if not (math.isfinite(value) and low <= value <= high):
                raise InputError(
                    f"{name} of a Maxwell branch must lie in [{low:g}, {high:g}], got {value:g}"
                )


def check_branches(branches: Sequence[MaxwellBranch]) -> tuple[MaxwellBranch, ...]:
    """Return branches as a tuple, of at most ``MOST_BRANCHES``.

    Raises:
        InputError: There are more, or something else among them.
    """
    for branch in branches:
        if not isinstance(branch, MaxwellBranch):
            raise InputError(f"branches must hold MaxwellBranch objects, got {branch!r}")
    if len(branches) > MOST_BRANCHES:
        raise InputError(
            f"a material has at most {MOST_BRANCHES} Maxwell branches, got {len(branches)}"
        )
    return tuple(branches)
