# SPDX-License-Identifier: Apache-2.0
"""The judge of a profile's design parameters: the bounds of its family.

Families stand above profiles, and packages bring more of them. So the catalogue is named here as an
entry point names an object, not imported; it is loaded when the first profile is read.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from taccel_lab.profile.schema import SensorBlock

_CATALOGUE = "taccel_lab.sensors.registry:judge_parameters"


class ParameterVerdict(NamedTuple):
    """What a catalogue says of a block's parameters."""

    faults: tuple[str, ...] = ()
    """What the bounds of the family refuse, a sentence each."""
    unjudged: str = ""
    """Why nobody could judge them; empty where somebody did."""


def judge_parameters(sensor: SensorBlock) -> ParameterVerdict:
    """The verdict of the catalogue's families."""
    return _judge()(sensor)


@cache
def _judge() -> Callable[[SensorBlock], ParameterVerdict]:
    return resolve_name(_CATALOGUE)
