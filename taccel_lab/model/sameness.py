# SPDX-License-Identifier: Apache-2.0
"""Are two models of the same bodies? Nodes, elements and materials decide what a state means."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from taccel_lab.model.model import Model


def same_bodies(first: Model, second: Model) -> bool:
    """Whether a state of one model is a state of the other; looks at arrays of the device only
    where the models are two."""
    if first is second:
        return True
    mine, theirs = list(_parts(first)), list(_parts(second))
    return len(mine) == len(theirs) and all(map(np.array_equal, mine, theirs))


def _parts(model: Model) -> Iterator[Any]:
    yield [(body.name, body.kind.value, *body.nodes) for body in model.bodies]
    for array in (
        model.rest_positions,
        model.masses,
        model.parents,
        model.weights,
        model.affine.stiffness,
        model.pair_friction,
    ):
        yield array.numpy()
    for group in model.elastic:
        yield [str(part) for part in (group.law, group.element, group.branches)]
        for array in (
            group.elements,
            group.shape_gradients,
            group.mu,
            group.lam,
            group.mooney_ratio,
        ):
            yield array.numpy()
