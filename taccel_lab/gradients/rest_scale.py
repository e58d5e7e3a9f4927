# SPDX-License-Identifier: Apache-2.0
"""What the numbers of collisions become where a gel is made larger.

Areas that weight a contact, thresholds of mollifiers, ranges within a body and insets of curved
faces follow from the rest shape. They are asked of the narrow phase itself, on surfaces a little
larger and smaller, and not derived again: areas are squares of the size, thresholds squares or
fourth powers, so that the differences are exact to the square of the step.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.potentials.contact_derivatives import (
    INSET,
    RANGE,
    THRESHOLD,
    ContactDerivatives,
)
from taccel_lab.model import Model
from taccel_lab.solvers import SolverConfig

_STEP = 1e-4
NUMBERS = {"thresholds": THRESHOLD, "insets": INSET, "ranges": RANGE}


def _scaled(model: Model, body: int, scale: float) -> Model:
    """The model with the surface of a gel as it would be ``scale`` times as large."""
    place = model.bodies[body]
    surface = model.surface

    def grown(array: wp.array, between: tuple[int, int], power: int) -> wp.array:
        values = array.numpy().copy()
        values[:, slice(*between)] *= scale**power
        return wp.array(values, dtype=array.dtype, device=model.device)

    return replace(
        model,
        rest_positions=grown(model.rest_positions, place.nodes, 1),
        surface=replace(
            surface,
            node_areas=grown(surface.node_areas, place.nodes, 2),
            edge_areas=grown(surface.edge_areas, place.edges, 2),
            face_areas=grown(surface.face_areas, place.faces, 2),
            face_reaches_sq=grown(surface.face_reaches_sq, place.faces, 2),
        ),
    )


class RestScale:
    """Collisions of the rest shapes on both sides of a gel's own."""

    def __init__(self, model: Model, config: SolverConfig, body: int) -> None:
        self._sides = [
            Collisions(
                _scaled(model, body, 1 + side * _STEP),
                config.kappa_pa,
                config.dhat_m,
                limit=config.max_collisions,
            )
            for side in (-1, 1)
        ]

    def update(self, active: wp.array, positions: wp.array, candidates: Candidates) -> None:
        """Collisions at ``positions`` among ``candidates``, see ``Collisions.update``."""
        for side in self._sides:
            side.update(active, positions, candidates)

    def force_derivatives(self, env: int, derivatives: ContactDerivatives) -> np.ndarray:
        """d forces of the collisions ``derivatives`` / d scale at the same positions [N], shape
        [collision, 4, 3]. A collision that one side does not have is at the end of its range, where
        it has no force."""
        by_scale = np.zeros((len(derivatives.nodes), 4))
        for side, sign in zip(self._sides, (-1, 1), strict=True):
            columns = {name: side.of(env, getattr(side, name)) for name in Collisions.columns}
            keys = _keys(columns["kinds"], columns["stencils"])
            at = {key: row for row, key in enumerate(keys)}
            rows = [at.get(key, -1) for key in _keys(derivatives.kinds, derivatives.nodes)]
            known = np.array(rows, dtype=np.int64) >= 0
            values = np.stack(
                [columns["stiffnesses"], *(columns[name] for name in NUMBERS)], axis=1
            )
            both = values[np.array(rows, dtype=np.int64)[known]]
            by_scale[known] += sign * both / (2 * _STEP)
            by_scale[~known] = np.nan
        by_scale = np.nan_to_num(by_scale)
        stiff = derivatives.stiffnesses
        stiffer = np.divide(by_scale[:, 0], stiff, out=np.zeros_like(stiff), where=stiff != 0)
        found = stiffer[:, None, None] * derivatives.forces
        for i, column in enumerate(NUMBERS.values()):
            found += by_scale[:, 1 + i, None, None] * derivatives.columns[:, column]
        return found


def _keys(kinds: np.ndarray, stencils: np.ndarray) -> list[bytes]:
    rows = np.column_stack([kinds, stencils.reshape(len(kinds), 4)]).astype(np.int64)
    return [row.tobytes() for row in rows]
