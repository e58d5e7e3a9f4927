# SPDX-License-Identifier: Apache-2.0
"""Starts that no step can be taken from, refused before the first one.

Is the state finite, do no two bodies overlap, is there a gap between those that may touch?
"""

from __future__ import annotations

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry.tet_checks import first_of
from taccel_lab.ipc.contact.gaps import SurfacePairs
from taccel_lab.ipc.contact.intersection import require_separated
from taccel_lab.model import Model
from taccel_lab.state import State, check_state

LEAST_GAP_OVER_DHAT = 1e-4
"""Smallest gap at the start, as a part of dhat: below, the barrier is so stiff that its forces
drown in rounding."""


def check_start(model: Model, state: State, dhat_m: float) -> None:
    """Refuse a state that a step cannot start from.

    Environments whose nodes are bitwise those of an earlier one are not looked at again.

    Raises:
        InputError: NaN, inverted tets, bodies that overlap, or gaps below a ten-thousandth of
            ``dhat_m`` between bodies that may touch; with environment, bodies and ids.
    """
    check_state(state, model)
    check_finite(model, state)
    require_separated(model, state)
    check_gaps(model, state, LEAST_GAP_OVER_DHAT * dhat_m)


def check_finite(model: Model, state: State) -> None:
    """Refuse a state with NaN or infinite values, naming environment, body and node."""
    bodies = model.surface.node_bodies.numpy()
    for name in ("positions", "velocities", "external_forces"):
        array = getattr(state, name)
        if array is None:
            continue
        bad = np.argwhere(~np.isfinite(array.numpy()).all(axis=2))
        if len(bad):
            env, node = bad[0]
            raise InputError(
                f"state.{name} holds {len(bad)} NaN or infinite vectors: environment {env}, "
                f"node {node} of {model.bodies[bodies[node]].name!r}"
            )
    for name in ("poses", "wrenches"):
        array = getattr(state, name)
        if array is None:
            continue
        value = array.numpy().reshape(model.env_count, -1)
        bad = np.flatnonzero(~np.isfinite(value).all(axis=1))
        if len(bad):
            raise InputError(
                f"state.{name} holds NaN or infinite values in environments {first_of(bad)}"
            )


def check_gaps(model: Model, state: State, least_m: float) -> None:
    """Refuse gaps below ``least_m`` between bodies that may touch, naming faces, nodes, edges."""
    pairs = SurfacePairs(model)
    positions = state.positions.numpy()
    present = model.present.numpy() != 0
    seen: set[tuple[bytes, bytes]] = set()
    for env in range(model.env_count):
        key = (positions[env].tobytes(), present[env].tobytes())
        if key in seen:
            continue
        seen.add(key)
        near = pairs.nearer_than(positions[env], present[env], least_m, int(env))
        if len(near.gaps_m):
            worst = int(near.gaps_m.argmin())
            first, second = (model.bodies[body].name for body in near.bodies[worst])
            raise InputError(
                f"{first!r} and {second!r} start too close in environment {env}: a gap of "
                f"{near.gaps_m[worst]:.3g} m between {near.where(worst)} (and "
                f"{len(near.gaps_m) - 1} other pairs); at least {least_m:.3g} m is needed, "
                "thickness and radius of a ball taken off"
            )
