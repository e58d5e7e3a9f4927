# SPDX-License-Identifier: Apache-2.0
"""What of the solver a scene needs, and why: only that is built, launched and compiled."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.model.model import BodyKind
from taccel_lab.solvers.solver_parts import SolverParts


@dataclass(frozen=True)
class PlanEntry:
    """One part of the solver."""

    part: str
    on: bool
    why: str


@dataclass(frozen=True)
class Plan:
    """All parts, in the order of a step."""

    entries: tuple[PlanEntry, ...]

    def is_on(self, part: str) -> bool:
        """Whether a part runs; KeyError for a part that does not exist."""
        for entry in self.entries:
            if entry.part == part:
                return entry.on
        raise KeyError(f"{part!r}; parts are {', '.join(e.part for e in self.entries)}")

    def describe(self) -> str:
        """A table for people: part, on or off, reason."""
        width = max(len(entry.part) for entry in self.entries)
        lines = [
            f"{entry.part:<{width}}  {'on ' if entry.on else 'off'}  {entry.why}"
            for entry in self.entries
        ]
        return "\n".join(lines)


def _count(number: int, what: str) -> str:
    """A number of things, whose plural is given."""
    one = {
        "bodies": "body",
        "bonded nodes": "bonded node",
        "Maxwell branches": "Maxwell branch",
    }.get(what, what.removesuffix("s"))
    return f"{number:,} {what if number != 1 else one}"


def make_plan(solver: SolverParts) -> Plan:
    """Read the plan off what the solver has built."""
    model, scene = solver.model, solver.model.scene
    jobs, time = model.contact_plan, model.scene.time
    prescribed = [b for b in model.bodies if b.kind in (BodyKind.KINEMATIC, BodyKind.PLANE)]
    carried = len(model.affine.carried)
    bonded = model.soft_count + 4 * model.affine.count - model.free_count - carried
    mounted = [b.name for b in scene.soft_bodies if b.mount is not None and not scene.carrier(b)]
    stiff = len(jobs.node_target) + len(jobs.face_target) + len(jobs.edge_target)
    selves = [model.bodies[i].name for i, j in jobs.pairs if i == j]
    groups = ", ".join(
        f"{_count(group.element_count, 'tets')} ({group.law}, {group.element})"
        for group in model.elastic
    )
    absent = any(body.surface.environments is not None for body in scene.bodies)
    faces, nodes = len(jobs.ball_face), len(jobs.node_plane)
    frames = f"{_count(len(prescribed), 'bodies')} and {_count(bonded, 'bonded nodes')} carry no "
    frames += "unknowns" + (f"; {', '.join(mounted)} on a mount" if mounted else "")
    affine = _count(model.affine.count, "bodies")
    affine += f" that carry {_count(carried, 'bonded nodes')}" if carried else ""
    unknowns = f"{3 * model.free_count:,} an environment, {model.env_count} of them"
    joints = _count(len(scene.joints), "joints")
    capture = solver.config.capture
    parts: list[tuple[str, object, str, str]] = [
        # Name, what it runs for, why it does and why it does not.
        ("unknowns", True, unknowns, ""),
        ("prescribed motion", len(model.frame_nodes), frames, frames),
        ("elasticity", model.elastic, groups, "no soft body"),
        (
            "relaxation",
            solver.maxwell,
            _count(len(solver.maxwell), "Maxwell branches"),
            "no branch",
        ),
        ("inertia", solver.inertia, f"{time.scheme}, dt {time.dt_s:g} s", "quasi-static"),
        ("affine bodies", model.affine.count, affine, affine),
        ("joints", solver.joints, joints, joints),
        (
            "external loads",
            solver.load,
            "the state has forces",
            "no force or wrench was set so far",
        ),
        (
            "search in body frames",
            stiff,
            f"{stiff:,} primitives against trees that are never rebuilt",
            "no pair with an affine or kinematic mesh may touch",
        ),
        ("search of balls", faces, _count(faces, "faces"), "no ball"),
        ("planes", nodes, _count(nodes, "nodes"), "no plane"),
        (
            "search among soft bodies",
            jobs.soft_to_soft,
            f"{_count(len(jobs.soft_faces), 'faces')} in refitted trees",
            "no two soft bodies may touch, none itself",
        ),
        ("self-contact", selves, ", ".join(selves), "asked of no soft body"),
        (
            "friction",
            solver.friction,
            "a pair that may touch has a coefficient",
            "no pair that may touch has a coefficient",
        ),
        (
            "absent bodies",
            absent,
            "objects differ by environment",
            "all bodies are in all environments",
        ),
        ("linear solver", True, solver.linear.describe(), ""),
        (
            "captured graph",
            capture,
            "a step is one launch, from the second with the same state on",
            "SolverConfig.capture is off",
        ),
    ]
    return Plan(tuple(PlanEntry(n, bool(on), yes if on else no) for n, on, yes, no in parts))
