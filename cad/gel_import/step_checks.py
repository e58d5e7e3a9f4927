# SPDX-License-Identifier: Apache-2.0
"""What the body of a STEP file must be: one closed, clean solid."""

# OCP ships no type stubs.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from build123d import Solid
from OCP.BOPAlgo import BOPAlgo_CheckStatus
from OCP.BRep import BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_Check
from OCP.BRepCheck import BRepCheck_Analyzer

from taccel_lab.cad.gel_import.step_reader import StepBody
from taccel_lab.errors import InputError

_LISTED = 40
"""Solids that a message names."""


def chosen_body(bodies: Sequence[StepBody], path: Path, name: str | None) -> StepBody:
    """The only solid of a file, or the one of a name, or of a number, from 1, where no solid has
    that name."""
    solids = [body for body in bodies if body.is_solid]
    if not solids:
        count = sum(_open_edges(body) for body in bodies)
        state = f"open at {count} edges. Close it and export" if count else "closed. Export"
        if not any(body.shape.faces() for body in bodies):
            state = "empty. Export"
        raise InputError(
            f"{path} holds {len(bodies)} shell(s) but no solid: the surface is {state} a solid"
        )
    words = ", ".join(
        f"{number} {body.name or 'without a name'} ({body.shape.volume:.1f} mm^3)"
        for number, body in enumerate(solids[:_LISTED], 1)
    ) + (f" and {len(solids) - _LISTED} more" if len(solids) > _LISTED else "")
    if name is not None:
        numbered = {str(number): [body] for number, body in enumerate(solids, 1)}
        named = [body for body in solids if body.name == name]
        solids = named or numbered.get(name, [])
    if len(solids) == 1:
        return solids[0]
    wanted = f" of the name {name!r}" if name is not None else ""
    raise InputError(
        f"{path} holds {len(solids)} solids{wanted}; one is needed. There are: {words}. Say which "
        "one with --body, by name or number, or export the gel alone"
    )


def _open_edges(body: StepBody) -> int:
    faces = body.shape.faces()
    edges = [edge for face in faces for edge in face.edges()]
    return sum(sum(edge.is_same(other) for other in edges) == 1 for edge in edges)


def check_solid(solid: Solid, path: Path) -> None:
    """Raise InputError for an open, invalid, inside-out or self-intersecting solid."""
    for shell in solid.shells():
        if not BRep_Tool.IsClosed_s(shell.wrapped):
            raise InputError(f"{path}: the solid's shell is open, so that it is not watertight")
    # The first two arguments after the shape: no test for small edges, one for self-interference.
    found = BRepAlgoAPI_Check(solid.wrapped, False, True)
    crossings = sum(
        result.GetCheckStatus() == BOPAlgo_CheckStatus.BOPAlgo_SelfIntersect
        for result in found.Result()
    )
    if crossings:
        raise InputError(
            f"{path}: the solid intersects itself in {crossings} places; repair it in the program "
            "that it comes from"
        )
    if not BRepCheck_Analyzer(solid.wrapped).IsValid():
        bad = [
            k
            for k, face in enumerate(solid.faces())
            if not BRepCheck_Analyzer(face.wrapped).IsValid()
        ]
        where = f" (faces {', '.join(map(str, bad[:10]))})" if bad else ""
        raise InputError(
            f"{path}: the CAD kernel finds the solid invalid{where}; repair it in the program that "
            "it comes from"
        )
    if solid.volume <= 0:
        raise InputError(f"{path}: the solid has a volume of {solid.volume:.3g} mm^3")
