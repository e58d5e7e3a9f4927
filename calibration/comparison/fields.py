# SPDX-License-Identifier: Apache-2.0
"""The values of two profiles, key by key, with their difference in standard deviations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from taccel_lab.profile import Block, SensorProfile

SIGNIFICANT_Z = 1.959963984540054
"""Differences beyond this many standard deviations are not chance, at 95 %."""

NETWORK_SCALES = ("input_mean", "input_scale", "output_scale")


@dataclass(frozen=True)
class FieldDifference:
    """One key whose values differ."""

    block: str
    field: str
    a: Any
    b: Any
    difference: float | None = None
    """b minus a; None of what is not a number."""
    relative: float | None = None
    """Difference over the mean size of both."""
    sigma: float | None = None
    """Standard deviation of the difference from both spreads; None where neither states one."""
    z: float | None = None
    """Difference over sigma."""

    @property
    def significant(self) -> bool | None:
        """Whether the difference exceeds what the spreads explain; None where they are unknown."""
        return None if self.z is None else abs(self.z) > SIGNIFICANT_Z


def compare_fields(a: SensorProfile, b: SensorProfile) -> list[FieldDifference]:
    """Every key with different values, in the order of the file; a missing block reads None."""
    differences: list[FieldDifference] = []
    blocks_a, blocks_b = a.blocks(), b.blocks()
    for key in dict.fromkeys([*blocks_a, *blocks_b]):
        first, second = blocks_a.get(key), blocks_b.get(key)
        if first is None or second is None:
            one, other = ("missing" if block is None else "present" for block in (first, second))
            differences.append(FieldDifference(key, "block", one, other))
            continue
        values_a, values_b = _flat_values(first), _flat_values(second)
        for field in dict.fromkeys([*values_a, *values_b]):
            left, right = values_a.get(field), values_b.get(field)
            if left != right:
                sigma = _sigma(field, first, second)
                differences.append(_difference(key, field, left, right, sigma))
    return differences


def _difference(block: str, field: str, a: Any, b: Any, sigma: float | None) -> FieldDifference:
    numbers = [v for v in (a, b) if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(numbers) < 2:
        return FieldDifference(block, field, a, b)
    change = float(b - a)
    size = (abs(a) + abs(b)) / 2
    z = change / sigma if sigma else None
    return FieldDifference(block, field, a, b, change, change / size if size else None, sigma, z)


def _sigma(field: str, a: Block, b: Block) -> float | None:
    spreads = [block.provenance.spread.get(field) for block in (a, b)]
    known = [s for s in spreads if s is not None]
    return math.hypot(*known) if known else None


def _flat_values(block: Block) -> dict[str, Any]:
    """Values by dotted key, lists by index; without provenance, file names and what belongs to the
    weights of a network, whose answers are compared instead."""
    values = block.model_dump(mode="python")
    values.pop("provenance")
    values.pop("file", None)
    if isinstance(values.get("architecture"), dict):
        values["architecture"] = {
            name: value
            for name, value in values["architecture"].items()
            if name not in NETWORK_SCALES
        }
    return dict(_flatten(values))


def _flatten(value: Any, prefix: str = "") -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        items: Any = value.items()
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    else:
        return [(prefix, value)]
    dot = f"{prefix}." if prefix else ""
    return [pair for name, item in items for pair in _flatten(item, f"{dot}{name}")]
