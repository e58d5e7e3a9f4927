# SPDX-License-Identifier: Apache-2.0
"""Sliders of a family's parameters, by group, with bounds and sources, and refusals beside them;
undo and redo of what they were moved to."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from taccel_lab.cad.parameters import Parameter, parse_value, value_text
from taccel_lab.report.page_text import Note, PageText, add_html_note
from taccel_lab.viewer.arrows import round_length

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.sensors.base import SensorFamily


OPEN_GROUPS = ("gel", "material")
"""Groups that are unfolded at first."""
WIDE = 100.0
"""Largest value over the default from which a number is typed, not slid to."""
_STEPS = 500
"""Places of a slider at least, besides its ends."""


class DesignControls:
    """One control a parameter; ``changed(name)`` is called when a user moves one."""

    def __init__(
        self,
        server: ViserServer,
        family: SensorFamily,
        overrides: Mapping[str, Any],
        changed: Callable[[str], None],
    ) -> None:
        self._known = family.parameters_type.parameters()
        self._handles: dict[str, Any] = {}
        self._initial: dict[str, Any] = {}
        self._notes: dict[str, Note] = {}
        self._texts: set[str] = set()
        """Parameters with a value for each of several things, which are written with commas."""
        self._silent = False
        self._changed = changed
        groups: dict[str, list[Parameter]] = {}
        for parameter in self._known.values():
            groups.setdefault(parameter.group or "gel", []).append(parameter)
        for group, parameters in sorted(groups.items(), key=lambda one: one[0] not in OPEN_GROUPS):
            with server.gui.add_folder(group, expand_by_default=group in OPEN_GROUPS):
                for parameter in parameters:
                    self._add(server, parameter, overrides.get(parameter.name, parameter.default))

    def overrides(self) -> dict[str, Any]:
        """Parameters other than the family's defaults."""
        found = {}
        for name, handle in self._handles.items():
            parameter = self._known[name]
            value = handle.value
            # A slider shows a default that is not one of its places; unmoved, it is the default.
            if value == self._initial[name][0]:
                value = self._initial[name][1]
            elif name in self._texts:
                value = parse_value(value)
                value = tuple(value) if isinstance(value, list) else value
            if value != parameter.default:
                found[name] = value
        return found

    def set(self, name: str, value: Any) -> None:
        """Sets a control as if a user had moved it."""
        self._handles[name].value = value

    def set_all(self, overrides: Mapping[str, Any]) -> None:
        """Set parameters, those not named to the family's defaults; one change for all of them."""
        self._silent = True
        for name, handle in self._handles.items():
            value = overrides.get(name, self._known[name].default)
            shown = value_text(value) if name in self._texts else value
            handle.value = self._initial[name][0] if value == self._initial[name][1] else shown
        self._silent = False
        self._changed("")

    def refuse(self, sentence: str, moved: str) -> None:
        """Show a refusal at the parameters that it names, or at the one that was moved last."""
        named = [name for name in self._known if re.search(rf"\b{name}\b", sentence)]
        for name in named or [moved] * bool(moved):
            self._show(name, sentence, "#d55e00")

    def accept(self) -> None:
        """Take refusals away."""
        for note in self._notes.values():
            if note.visible:
                note.visible = False

    def remark(self, name: str, sentence: str) -> None:
        """Show a sentence below a parameter, until the next ``accept``."""
        self._show(name, sentence, "#6b7280")

    def _show(self, name: str, sentence: str, color: str) -> None:
        self._notes[name].content = PageText(
            '<div style="color:{};font-size:0.8em;padding:0 1em 0.4em">{}</div>'
        ).format(PageText(color), sentence)
        self._notes[name].visible = True

    def _add(self, server: ViserServer, parameter: Parameter, value: Any) -> None:
        hint = f"{parameter.description}. Allowed: {parameter.allowed()}. {parameter.source}"
        if isinstance(value, (tuple, list)):
            self._texts.add(parameter.name)
            handle: Any = server.gui.add_text(parameter.label, value_text(value), hint=hint)
        elif parameter.choices:
            handle = server.gui.add_dropdown(
                parameter.label, parameter.choices, initial_value=value, hint=hint
            )
        else:
            low, high, step = slider_places(parameter)
            kind = int if isinstance(parameter.default, int) else float
            if 0 < WIDE * abs(parameter.default) < high:
                # A slider over such a range has no place near the default.
                handle = server.gui.add_number(
                    parameter.label, kind(value), min=kind(low), max=kind(high), hint=hint
                )
            else:
                handle = server.gui.add_slider(
                    parameter.label,
                    kind(low),
                    kind(high),
                    kind(step),
                    kind(value),
                    hint=hint,
                )
        self._handles[parameter.name] = handle
        self._initial[parameter.name] = (handle.value, value)
        self._notes[parameter.name] = add_html_note(server.gui, visible=False)
        handle.on_update(lambda _: None if self._silent else self._changed(parameter.name))


def slider_places(parameter: Parameter) -> tuple[float, float, float]:
    """Least, largest and step of a parameter's slider; 0 is the least where it has a meaning."""
    low, high = float(parameter.minimum or 0.0), float(parameter.maximum or 0.0)
    low = min(low, 0.0) if parameter.zero_means else low
    if isinstance(parameter.default, int):
        return low, high, 1
    step = round_length((high - low) / _STEPS)
    # Fine enough for the default, where three digits of it are.
    if parameter.default:
        digits = math.floor(math.log10(abs(parameter.default))) - 2
        step = min(step, max(10.0**digits, step / 10))
    return low, high, step


T = TypeVar("T")

TOGETHER_S = 1.0
"""Changes of one control within this time of each other are one step: a slider that is dragged."""


class History(Generic[T]):
    """Values in the order in which they came, and which of them is current."""

    def __init__(self, first: T, clock: Callable[[], float] = time.monotonic) -> None:
        self._values, self._at = [first], 0
        self._clock, self._control, self._changed_s = clock, "", float("-inf")

    def add(self, value: T, control: str) -> None:
        """Append a value that a change of ``control`` led to; what was undone is dropped."""
        if value == self._values[self._at]:
            return
        now = self._clock()
        together = control == self._control and now - self._changed_s < TOGETHER_S
        del self._values[self._at + 1 :]
        if together and self._at:
            self._values[self._at] = value
        else:
            self._values.append(value)
            self._at += 1
        self._control, self._changed_s = control, now

    def step(self, by: int) -> T | None:
        """Go back (-1) or forth (1) and return that value; None at the end."""
        if not 0 <= self._at + by < len(self._values):
            return None
        self._at, self._control = self._at + by, ""
        return self._values[self._at]
