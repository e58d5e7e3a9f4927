# SPDX-License-Identifier: Apache-2.0
"""Presses that are fitted, and those that are held out.

Presses are held out by their names and labels, before any image is read. Presses of one place
(labels closer than a quarter of a contact radius, joined one to the next) stay together, so that no
held-out press has a twin among those that are fitted. Places are held out in the order of the
SHA-256 of their presses' names, which nobody can choose by looking at images. A press without a
label has no place before its image is read: it stands alone. A split that the manifest states
(``[split]``) is taken as it is.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from taccel_lab.errors import InputError


class _Circle(Protocol):
    @property
    def center_px(self) -> tuple[float, float]: ...

    @property
    def radius_px(self) -> float: ...


class Labelled(Protocol):
    """What a press is held out by."""

    @property
    def name(self) -> str: ...

    @property
    def circle(self) -> _Circle | None: ...


HOLDOUT_EVERY = 4
"""One press in this number is held out unless a command says otherwise."""
SAME_PLACE_RADII = 0.25
"""Labels closer than this many median contact radii are of one place."""
LARGEST_PLACE = 0.5
"""A place with more than this part of the presses cannot be held out, nor everything but it be."""


@dataclass(frozen=True)
class PressSplit:
    """Presses by index: those that are fitted, and those that are only scored."""

    train: tuple[int, ...]
    heldout: tuple[int, ...]
    heldout_names: tuple[str, ...]
    by: Literal["place", "press", "manifest", "nothing"]
    """``place``: labels tell places; ``press``: each press stands alone; ``manifest``: stated
    there; ``nothing``: none is held out."""
    gone: tuple[str, ...] = ()
    """Presses that the manifest holds out and that were left out since (``contacts.toml``): they
    count as failures, so that no figure gains by leaving a press out."""

    @property
    def sha256(self) -> str:
        """Hash of the names that are held out, by which two equal splits are recognised."""
        names = sorted((*self.heldout_names, *self.gone))
        return hashlib.sha256("\n".join(names).encode()).hexdigest()

    def figures(self) -> dict[str, Any]:
        """Figures for reports and profiles."""
        return {"heldout": list(self.heldout_names), "by": self.by, "sha256": self.sha256}


def split_presses(
    presses: Sequence[Labelled], holdout_every: int, stated: Sequence[str] | None, source: str
) -> PressSplit:
    """Hold out one press in ``holdout_every``, whole places at a time; 0 holds none out.

    Args:
        presses: Names and labels are read, images are not.
        holdout_every: 4 holds a quarter out, rounded down, less what whole places do not allow.
        stated: Names that the manifest holds out; they win over the rule, but not over 0.
        source: Named in messages.

    Raises:
        InputError: Too few presses, or a stated split that leaves nothing on one side.
    """
    if holdout_every == 0:
        return PressSplit(tuple(range(len(presses))), (), (), "nothing")
    if holdout_every < 2:
        raise InputError(f"--holdout-every must be 0 or at least 2, got {holdout_every}")
    if stated is not None:
        return _taken(presses, stated, source)
    count = len(presses)
    wanted = count // holdout_every
    if wanted == 0:
        or_fewer = f" or 2 to {count}" if count > 2 else " or 2" if count == 2 else ""
        raise InputError(
            f"{source} holds {count} press{'es' if count != 1 else ''}, too few to hold "
            f"out one in {holdout_every}; give more captures, or --holdout-every 0{or_fewer}"
        )
    places = _places(presses)
    by: Literal["place", "press"] = "place"
    if max(len(place) for place in places) > LARGEST_PLACE * count:
        places, by = [[i] for i in range(count)], "press"
    elif all(press.circle is None for press in presses):
        by = "press"

    def lot(place: Sequence[int]) -> str:
        names = "\n".join(sorted(presses[i].name for i in place))
        return hashlib.sha256(names.encode()).hexdigest()

    places.sort(key=lot)
    held: list[int] = []
    for place in places:
        if len(held) + len(place) <= wanted:
            held += place
    if not held:
        held = min(places, key=len)
    return _split(presses, held, by)


def _taken(presses: Sequence[Labelled], stated: Sequence[str], source: str) -> PressSplit:
    names = [press.name for press in presses]
    wanted = set(stated)
    held = [i for i, name in enumerate(names) if name in wanted]
    if not held or len(held) == len(presses):
        what = "none" if not held else "all"
        raise InputError(
            f"{source}: [split] holds out {what} of the {len(presses)} presses; name some of them "
            "and leave others to fit"
        )
    known = set(names)
    gone = tuple(name for name in stated if name not in known)
    return replace(_split(presses, held, "manifest"), gone=gone)


def _split(
    presses: Sequence[Labelled], held: Sequence[int], by: Literal["place", "press", "manifest"]
) -> PressSplit:
    chosen = set(held)
    return PressSplit(
        tuple(i for i in range(len(presses)) if i not in chosen),
        tuple(sorted(chosen)),
        tuple(presses[i].name for i in sorted(chosen)),
        by,
    )


def _places(presses: Sequence[Labelled]) -> list[list[int]]:
    """Indices of the presses of each place."""
    labelled = [i for i, press in enumerate(presses) if press.circle is not None]
    alone = [[i] for i, press in enumerate(presses) if press.circle is None]
    if len(labelled) < 2:
        return alone + [[i] for i in labelled]
    circles = [circle for press in presses if (circle := press.circle) is not None]
    centers = np.array([c.center_px for c in circles])
    limit = SAME_PLACE_RADII * float(np.median([c.radius_px for c in circles]))
    # A distance is taken from one press to those without a place: never a matrix of all of them.
    left, places = np.arange(len(labelled)), []
    while len(left):
        front, left = [int(left[0])], left[1:]
        reached = []
        while front:
            at = front.pop()
            reached.append(at)
            near = np.linalg.norm(centers[left] - centers[at], axis=-1) < limit
            front += left[near].tolist()
            left = left[~near]
        places.append([labelled[k] for k in sorted(reached)])
    return places + alone
