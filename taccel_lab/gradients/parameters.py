# SPDX-License-Identifier: Apache-2.0
"""Moduli and friction that a motion was run with, kept with its record.

Calls with other parameters may come between a motion and its gradients. The adjoint needs those of
the motion: they are put into the model for it, and the model's own come back.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.model import Model

Array = np.ndarray


@dataclass(frozen=True)
class Parameters:
    """What ``Model.set_body`` and ``set_friction`` change and forces depend on, as it was once."""

    model: Model
    values: list[Array]
    """Values of each of ``_arrays``, which may have got more rows since."""
    own: list[tuple[Array, Array] | None]
    """Young's moduli [Pa] and Poisson's ratios of each group of elements, [env_count,
    element_count]; None where they were those of the scene."""

    @staticmethod
    def of(model: Model) -> Parameters:
        """Copy those that a model has now."""
        own = []
        for group in model.elastic:
            young, poisson, rows = group.young_moduli, group.poisson_ratios, model.env_count
            if young is None or poisson is None:
                own.append(None)
            else:
                own.append(tuple(a.numpy().reshape(rows, -1).copy() for a in (young, poisson)))
        return Parameters(model, [array.numpy().copy() for array in _arrays(model)], own)

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Have the model hold them for a while."""
        arrays = _arrays(self.model)
        present = [array.numpy().copy() for array in arrays]
        try:
            _put(arrays, self.values)
            yield
        finally:
            _put(arrays, present)

    def of_gel(self, gel: int) -> tuple[Array, Array]:
        """Young's modulus [Pa] and Poisson's ratio of a gel, one or [env_count] each.

        Raises:
            InputError: They differ by tet.
        """
        for group, own in zip(self.model.elastic, self.own, strict=True):
            for body, first, end in group.bodies:
                if body == gel and own is not None:
                    both = [value[:, first:end] for value in own]
                    if any((value != value[:, :1]).any() for value in both):
                        raise InputError(
                            "gradients need a gel of one material: that of "
                            f"{self.model.bodies[gel].name!r} was set by tet"
                        )
                    return both[0][:, 0], both[1][:, 0]
        material = self.model.scene.soft_bodies[gel].material
        return np.asarray(material.young_modulus_pa), np.asarray(material.poisson_ratio)


def _arrays(model: Model) -> list[wp.array]:
    """What kernels of forces read, float64."""
    moduli = [array for group in model.elastic for array in (group.mu, group.lam)]
    return [*moduli, model.pair_friction, model.largest_moduli]


def _put(arrays: list[wp.array], values: list[Array]) -> None:
    """Write values in place, as captured graphs keep the addresses; one row goes to all."""
    for array, value in zip(arrays, values, strict=True):
        array.assign(np.resize(value, array.shape))
