# SPDX-License-Identifier: Apache-2.0
"""Room for what an image asks for, where sizes cannot follow the image.

A recorded graph of a GPU has fixed sizes: how many blocks are looked at closely, how many steps a
solution takes. While a reading stands in a ``Room``, each such size is what its first images asked
for, and some more. What an image needs is kept beside its result. Where that is more than there was
room for, the result does not count: the room is made larger, and the image read again. Errors of
input are kept, too, until somebody asks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, TypeVar

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import torch

Found = TypeVar("Found")
SPARE = 1.25
"""Room over what the first images ask for."""
STEP = 256
"""Rooms are multiples of this, or all that there is."""


class Room:
    """Sizes of a reading that cannot follow its images."""

    def __init__(self) -> None:
        self._sizes: dict[str, int] = {}
        self._most: dict[str, int] = {}
        self._needs: dict[str, torch.Tensor] = {}
        self._checks: list[tuple[torch.Tensor, Callable[[], str]]] = []
        self.counted: torch.Tensor | None = None
        """Places of those that are asked about just now that hold something; None for all."""
        self.known_once: dict[str, Any] = {}
        """What the first reading found out of inputs that stay (``once``)."""

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Context of one reading with these sizes, whose needs and checks replace those before."""
        self._needs, self._checks, self.counted = {}, [], None
        before = _entered.set(self)
        try:
            yield
        finally:
            _entered.reset(before)

    def size(self, name: str, need: torch.Tensor, most: int) -> int:
        """Room for what ``name`` calls, of which a reading needs so many, a count on its device,
        and ``most`` at most."""
        if name not in self._sizes:
            wanted = -(-int(SPARE * int(need)) // STEP) * STEP
            self._sizes[name] = min(max(wanted, STEP), most)
        self.needs(name, need, most)
        return self._sizes[name]

    def known(self, name: str) -> int | None:
        """Room that there is, None before the first reading."""
        return self._sizes.get(name)

    def needs(self, name: str, need: torch.Tensor, most: int, size: int | None = None) -> None:
        """Note what a reading needs; ``size``: the room from now on."""
        if size is not None:
            self._sizes[name] = min(size, most)
        self._needs[name], self._most[name] = need, most

    def check(self, holds: torch.Tensor, fault: Callable[[], str]) -> None:
        """Note what has to hold for a result to count."""
        self._checks.append((holds, fault))

    def asked(self) -> torch.Tensor:
        """Needs, then whether each check holds, int64, of the reading's device."""
        import torch

        found = [*self._needs.values(), *(holds for holds, _ in self._checks)]
        return torch.stack([each.to(torch.int64).reshape(()) for each in found])

    def enough(self, asked: list[int]) -> bool:
        """Whether there was room for a result by what it asked for (``asked``); makes it where
        there was not. Raises the first InputError that was kept."""
        held = asked[len(self._needs) :]
        enough = True
        for name, need in zip(self._needs, asked, strict=False):
            size, most = self._sizes[name], self._most[name]
            while size < min(need, most):
                size = min(2 * size, most)
            enough &= size == self._sizes[name]
            self._sizes[name] = size
        if enough:
            for holds, (_, fault) in zip(held, self._checks, strict=True):
                if not holds:
                    raise InputError(fault())
        return enough


_entered: ContextVar[Room | None] = ContextVar("room", default=None)


def room() -> Room | None:
    """The room that this reading stands in; None where sizes follow the image."""
    return _entered.get()


def once(name: str, find: Callable[[], Found]) -> Found:
    """What ``find`` looks up; in a room, the first time alone, of inputs that do not change."""
    here = room()
    if here is None:
        return find()
    if name not in here.known_once:
        here.known_once[name] = find()
    return here.known_once[name]


def require(holds: torch.Tensor, fault: Callable[[], str]) -> None:
    """InputError by ``fault`` unless all of ``holds``; in a room, once its result is asked for."""
    here = room()
    if here is not None:
        here.check(holds.all(), fault)
    elif not bool(holds.all()):
        raise InputError(fault())
