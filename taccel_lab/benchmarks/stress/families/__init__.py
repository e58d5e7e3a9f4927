# SPDX-License-Identifier: Apache-2.0
"""All families of cases by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from taccel_lab.benchmarks.stress.case import Draw, StressCase
from taccel_lab.benchmarks.stress.families import grasps, impacts, mechanisms, presses, strains

FAMILIES: dict[str, Callable[[Draw], StressCase]] = {
    make.__name__: make
    for make in (
        impacts.thin_gap,
        impacts.parallel_edges,
        impacts.soft_edges,
        grasps.throw_and_catch,
        grasps.ratios,
        grasps.pile,
        impacts.soft_impact,
        impacts.stiff_on_plane,
        impacts.stiff_on_gel,
        impacts.soft_on_soft,
        impacts.bullet_at_sheet,
        mechanisms.mechanism,
        mechanisms.jump,
        mechanisms.no_way,
        mechanisms.batch,
        mechanisms.resting,
        presses.press,
        presses.stab,
        presses.gel_on_gel,
        strains.twist,
        strains.swing,
        strains.squeeze,
        strains.fold,
        strains.pull,
        strains.roll_over,
    )
}


def make_case(name: str, seed: int) -> tuple[StressCase, dict[str, Any]]:
    """The case of a family and seed, and the parameters that were drawn; KeyError names all."""
    if name not in FAMILIES:
        raise KeyError(f"no family {name!r}; there are {', '.join(FAMILIES)}")
    draw = Draw(name, seed)
    return FAMILIES[name](draw), draw.values
