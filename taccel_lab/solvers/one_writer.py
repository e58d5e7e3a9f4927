# SPDX-License-Identifier: Apache-2.0
"""One solver at a time writes a state: its steps would end where another one's began."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol
from weakref import ref

from taccel_lab.errors import InputError
from taccel_lab.state import State

_SOLVER = "solver"


class Writer(Protocol):
    """A solver."""

    @property
    def underway(self) -> bool:
        """Whether steps of the state that it wrote last are underway."""
        ...


@contextmanager
def writing(state: State, solver: Writer) -> Iterator[None]:
    """Let ``solver`` alone write ``state`` in the block, and after it while steps are underway; a
    solver that is gone writes no more.

    Raises:
        InputError: Another solver has steps of the state at work, or this one has steps of another
            state underway.
    """
    known = state.writers.get(_SOLVER)
    if solver.underway and (known is None or known() is not solver):
        raise InputError(
            "the solver has steps of another state underway (see ReadySteps): drop these first, "
            "or step this state on another solver"
        )
    # In one call, as threads may come at the same time.
    owner = state.writers.setdefault(_SOLVER, ref(solver))()
    if owner is None:
        state.writers[_SOLVER] = ref(solver)
    elif owner is not solver:
        raise InputError(
            "another solver is stepping this state: give each solver its own state "
            "(state.copy()), or let one finish its steps before the other begins"
        )
    try:
        yield
    finally:
        if not solver.underway:
            state.writers.clear()
