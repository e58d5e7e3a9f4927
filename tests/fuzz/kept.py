# SPDX-License-Identifier: Apache-2.0
"""Seeds that every run of the tests tries: each way to damage each file, and every fault so far."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path

from tests.fuzz.example import Outcome

KEPT = Path(__file__).with_name("kept.toml")
MOST = 30
"""Seeds of a reader that ``choose`` names."""


def kept() -> dict[tuple[str, int], str]:
    """What each kept seed did to the sample when it was kept: ``reader.seed = "mutation"``."""
    with KEPT.open("rb") as file:
        table = tomllib.load(file)
    return {
        (reader, int(seed)): mutation
        for reader, seeds in table.items()
        for seed, mutation in seeds.items()
    }


def entry(outcome: Outcome) -> str:
    """The line of a seed in the file of kept ones."""
    return f"{outcome.reader}.{outcome.seed} = {json.dumps(outcome.mutation)}\n"


def choose(outcomes: Iterable[Outcome]) -> str:
    """Seeds that between them do most of what can be done to each reader's sample, as TOML."""
    by_reader: dict[str, list[Outcome]] = {}
    for outcome in sorted(outcomes, key=lambda outcome: outcome.seed):
        if not outcome.fault:
            by_reader.setdefault(outcome.reader, []).append(outcome)
    lines = []
    for found in by_reader.values():
        done: set[str] = set()
        picked: list[Outcome] = []
        # First what reads on the furthest: damage that is accepted passes every check.
        for outcome in sorted(found, key=lambda outcome: outcome.kind != "accepted"):
            steps = set(outcome.mutation.split(", ")) - {"sealed"}
            kinds = {step.rpartition(": ")[2] for step in steps}
            if len(picked) < MOST and not kinds <= done:
                done |= kinds
                picked.append(outcome)
        lines += [entry(outcome) for outcome in sorted(picked, key=lambda o: o.seed)]
    return "".join(lines)
