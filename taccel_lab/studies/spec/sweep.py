# SPDX-License-Identifier: Apache-2.0
"""Designs of grids and random sweeps: all combinations, or points spread over the ranges."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Sequence
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study_file import MAX_DESIGNS


def grid_points(axes: Sequence[Axis]) -> list[dict[str, Any]]:
    """Every combination of the axes' values, the last axis fastest.

    Raises InputError when there are more than ``MAX_DESIGNS``.
    """
    counts = [len(axis.values or ()) for axis in axes]
    total = math.prod(counts)
    if not 0 < total <= MAX_DESIGNS:
        sizes = " x ".join(map(str, counts))
        raise InputError(
            f"the grid has {sizes} = {total:,} designs; 1 to {MAX_DESIGNS:,} are allowed"
        )
    names = [axis.name for axis in axes]
    return [
        dict(zip(names, values, strict=True))
        for values in itertools.product(*(axis.values or () for axis in axes))
    ]


def random_points(
    axes: Sequence[Axis], count: int, seed: int, sampler: str = "latin-hypercube"
) -> list[dict[str, Any]]:
    """``count`` designs spread evenly over all axes; the same ones for the same seed.

    A Latin hypercube has one design in each of ``count`` slices of every axis. Sobol points fill
    the ranges in sequence, so that a larger count keeps all earlier designs.
    """
    from scipy.stats import qmc

    if sampler == "sobol":
        engine = qmc.Sobol(len(axes), scramble=True, rng=seed)
        with warnings.catch_warnings():
            # Balance properties need a power of two; a study may stop anywhere in the sequence.
            warnings.filterwarnings("ignore", message="The balance properties of Sobol")
            units = engine.random(count)
    else:
        units = qmc.LatinHypercube(len(axes), rng=seed).random(count)
    return [
        {axis.name: axis.at(float(unit)) for axis, unit in zip(axes, row, strict=True)}
        for row in units
    ]
