# SPDX-License-Identifier: Apache-2.0
"""Which links and gels of a robot touch one another, where it touches itself.

A gel touches every link but those that are one with what carries it, and links touch links that are
not next to them; pairs that are named are left out. Two prescribed links never touch: the solver
does not search pairs of which neither moves freely.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.bodies.bodies import Surface
from taccel_lab.errors import InputError
from taccel_lab.robots.description import RobotJoint, listed

if TYPE_CHECKING:
    from taccel_lab.scene import Scene

Pairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class LinkPart:
    """A body of a scene that belongs to a robot."""

    body: str
    """Its name in the scene."""
    name: str
    """Name of the link or of the gel."""
    link: str
    """What it is, or what carries it."""
    gel: bool


def rigid_groups(links: Iterable[str], joints: Iterable[RobotJoint]) -> dict[str, str]:
    """First link, by link, of those that fixed joints connect it with."""
    carrier = {joint.child: joint for joint in joints}
    groups = {}
    for name in links:
        top = name
        while top in carrier and not carrier[top].moves:
            top = carrier[top].parent
        groups[name] = top
    return groups


def surfaces(
    parts: Sequence[LinkPart],
    links: Iterable[str],
    joints: Sequence[RobotJoint],
    apart: Pairs,
    layers: tuple[Surface, Surface],
) -> dict[str, Surface]:
    """Surface of each part, by its name in the scene.

    ``apart``: links and gels that do not touch. ``layers``: surfaces of links and of gels, without
    the names of what they are kept apart from.
    """
    groups = rigid_groups(links, joints)
    joined = {frozenset((groups[j.parent], groups[j.child])) for j in joints if j.moves}
    named = {frozenset(pair) for pair in apart}

    def separate(a: LinkPart, b: LinkPart) -> bool:
        if frozenset((a.name, b.name)) in named:
            return True
        if a.gel and b.gel:
            return False
        groups_of = frozenset((groups[a.link], groups[b.link]))
        return len(groups_of) == 1 or (not a.gel and not b.gel and groups_of in joined)

    return {
        a.body: replace(
            layers[a.gel],
            apart_from=frozenset(b.body for b in parts if b is not a and separate(a, b)),
        )
        for a in parts
    }


def on_surfaces(bodies: Sequence[Any], found: Mapping[str, Surface]) -> list[Any]:
    """Bodies of a scene with the surfaces that are found of them."""
    return [
        replace(body, surface=found[body.name]) if body.name in found else body for body in bodies
    ]


def checked_pairs(pairs: Iterable[tuple[str, str]], known: Iterable[str], robot: str) -> Pairs:
    """Pairs of names; InputError for what is no pair, or no link or gel."""
    names, found = list(known), []
    for pair in pairs:
        if isinstance(pair, str) or len(pair) != 2:
            raise InputError(f"apart has pairs of names of links and gels, got {pair!r}")
        for name in pair:
            if name not in names:
                raise InputError(
                    f"apart names {name!r}, which is no link or gel of robot {robot!r}; there are "
                    f"{listed(names)}"
                )
        found.append((pair[0], pair[1]))
    return tuple(found)


def overlapping(scene: Scene, poses: np.ndarray, parts: Sequence[LinkPart]) -> Pairs:
    """Links and gels that may touch in a scene and overlap where it starts.

    ``poses``: of its kinematic bodies, [1, body, 7].
    """
    from taccel_lab.ipc.contact.overlap_search import find_overlaps
    from taccel_lab.state import initial_state

    model = scene.finalize("cpu")
    names = {part.body: part.name for part in parts}  # Gels of surfaces of their own are none.
    (found,) = find_overlaps(model, initial_state(model, poses))
    pairs = [
        tuple(sorted(names.get(body, body) for body in (item.first, item.second))) for item in found
    ]
    return tuple((a, b) for a, b in dict.fromkeys(pairs) if a != b)


def require_apart(pairs: Pairs, robot: str) -> None:
    """Refuse pairs that overlap."""
    if pairs:
        pairs_text = ", ".join(f"({a!r}, {b!r})" for a, b in pairs)
        raise InputError(
            f"links and gels of robot {robot!r} overlap at the coordinates that are looked at, and "
            f"would touch: {pairs_text}. Give others, or keep these apart: "
            f"touching_itself(apart=[{pairs_text}])"
        )
