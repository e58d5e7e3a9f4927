# SPDX-License-Identifier: Apache-2.0
"""Metrics as a study reads them: one of each indenter at each load, named after both.

``contact_diameter[sphere:2, 0.5 N]`` is the metric of one indenter at one load; what a study has
only one of is left out of the name. ``contact_diameter`` alone, and ``contact_diameter[0.5 N]``,
stand for all that match.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from taccel_lab.errors import InputError
from taccel_lab.guards import require_known
from taccel_lab.studies.metrics.base import Metric

_GENERIC = {
    "sphere": "a ball", "shear": "a ball", "release": "a ball", "places": "one ball",
    "punch": "a flat punch", "cylinder": "a roller", "edge": "an edge", "grating": "a grating",
}  # fmt: skip
"""What ``{tool}`` is where no study says, by press."""


def split_name(name: str) -> tuple[str, tuple[str, ...]]:
    """``(base, labels)`` of a name such as ``depth_at_load[sphere:2, 1 N]``."""
    base, _, rest = name.partition("[")
    labels = [" ".join(word.split()) for word in rest.removesuffix("]").split(",")]
    return base, tuple(word for word in labels if word)


def load_label(load_n: float) -> str:
    """``0.5 N``."""
    return f"{load_n:g} N"


def described(metric: Metric) -> Metric:
    """A metric as lists show it, of no tool and load in particular."""
    press = metric.presses[0] if metric.presses else ""
    tool = _GENERIC.get(press, "a tool")
    if metric.also:
        tool = "a tool"
    return replace(metric, description=metric.description.format(tool=tool, load="the load"))


def tool_in_words(indenter: str) -> str:
    """``a ball of 2 mm radius`` of ``sphere:2``."""
    kind, _, size = indenter.partition(":")
    numbers = size.split("x")
    known = {
        "sphere": "a ball of {0} mm radius",
        "cylinder": "a flat punch of {0} mm radius",
        "roller": "a roller of {0} mm radius and {1} mm length",
        "edge": "an edge of {0} deg",
        "grating": "a grating of {0} mm pitch",
        "box": "a flat box of {0} x {1} mm",
    }
    return known[kind].format(*numbers) if kind in known else indenter


def press_of(metric: Metric, labels: Sequence[str], kit: Mapping[str, object]) -> str | None:
    """The press that a metric is read from where a study names none: the one of the kit that has
    the labelled indenter, else its own; None of a metric without."""
    for name in (*metric.presses, *metric.also):
        if set(labels) & set(getattr(kit.get(name), "indenters", ())):
            return name
    return metric.presses[0] if metric.presses else None


def readings(
    metric: Metric, labels: Sequence[str], presses: Mapping[str, object], loads_n: Sequence[float]
) -> list[Metric]:
    """The metric of each indenter of the study's presses at each load, those with all ``labels``.

    Raises InputError for a label that none has.
    """
    if not metric.presses:
        if labels:
            raise InputError(f"metric {metric.base!r} is read from no press; leave out {labels[0]}")
        return [replace(metric, description=described(metric).description)]
    tools: dict[str, str] = {}
    for press in (*metric.presses, *metric.also):
        for indenter in getattr(presses.get(press), "indenters", ("",)) if press in presses else ():
            tools.setdefault(indenter if metric.each_tool else "", press)
    loads = list(loads_n) if metric.at_load else [metric.load_n]
    found = []
    for indenter, press in tools.items():
        for load_n in loads:
            has = [indenter] if indenter else []
            has += [load_label(load_n)] if metric.at_load else []
            if not set(labels) <= set(has):
                continue
            shown = [indenter] if len(tools) > 1 else []
            shown += [load_label(load_n)] if len(loads) > 1 else []
            found.append(
                replace(
                    metric,
                    name=f"{metric.name}[{', '.join(shown)}]" if shown else metric.name,
                    description=metric.description.format(
                        tool=tool_in_words(indenter) if indenter else _GENERIC.get(press, "a tool"),
                        load=load_label(load_n),
                    ),
                    presses=(press,),
                    indenter=indenter,
                    load_n=load_n,
                )
            )
    if not found:
        known = [
            *(name for name in tools if name),
            *map(load_label, loads if metric.at_load else ()),
        ]
        wrong = next((label for label in labels if label not in known), labels[0])
        require_known(f"indenter or load of {metric.base!r} in this study", wrong, known)
    return found
