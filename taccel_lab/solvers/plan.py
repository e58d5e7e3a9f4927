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
    entries = [
        ("unknowns", True, f"{3 * model.free_count:,} an environment, {model.env_count} of them"),
        (
            "prescribed motion",
            len(model.frame_nodes) > 0,
            f"{_count(len(prescribed), 'bodies')} and {_count(bonded, 'bonded nodes')} carry no "
            "unknowns" + (f"; {', '.join(mounted)} on a mount" if mounted else ""),
        ),
        ("elasticity", bool(model.elastic), groups or "no soft body"),
        (
            "relaxation",
            bool(solver.maxwell),
            _count(len(solver.maxwell), "Maxwell branches") if solver.maxwell else "no branch",
        ),
        (
            "inertia",
            solver.inertia is not None,
            f"{time.scheme}, dt {time.dt_s:g} s" if solver.inertia else "quasi-static",
        ),
        (
            "affine bodies",
            model.affine.count > 0,
            _count(model.affine.count, "bodies")
            + (f" that carry {_count(carried, 'bonded nodes')}" if carried else ""),
        ),
        ("joints", solver.joints is not None, _count(len(scene.joints), "joints")),
        (
            "external loads",
            solver.load is not None,
            "the state has forces" if solver.load else "no force or wrench was set so far",
        ),
        (
            "search in body frames",
            stiff > 0,
            f"{stiff:,} primitives against trees that are never rebuilt"
            if stiff
            else "no pair with an affine or kinematic mesh may touch",
        ),
        (
            "search of balls",
            len(jobs.ball_face) > 0,
            _count(len(jobs.ball_face), "faces") if len(jobs.ball_face) else "no ball",
        ),
        (
            "planes",
            len(jobs.node_plane) > 0,
            _count(len(jobs.node_plane), "nodes") if len(jobs.node_plane) else "no plane",
        ),
        (
            "search among soft bodies",
            jobs.soft_to_soft,
            f"{_count(len(jobs.soft_faces), 'faces')} in refitted trees"
            if jobs.soft_to_soft
            else "no two soft bodies may touch, none itself",
        ),
        (
            "self-contact",
            bool(selves),
            ", ".join(selves) if selves else "asked of no soft body",
        ),
        (
            "friction",
            solver.friction is not None,
            "a pair that may touch has a coefficient"
            if solver.friction
            else "no pair that may touch has a coefficient",
        ),
        (
            "absent bodies",
            any(body.surface.environments is not None for body in scene.bodies),
            "objects differ by environment"
            if any(body.surface.environments is not None for body in scene.bodies)
            else "all bodies are in all environments",
        ),
        ("linear solver", True, solver.linear.describe()),
        (
            "captured graph",
            solver.config.capture,
            "a step is one launch, from the second with the same state on"
            if solver.config.capture
            else "SolverConfig.capture is off",
        ),
    ]
    return Plan(tuple(PlanEntry(*entry) for entry in entries))
