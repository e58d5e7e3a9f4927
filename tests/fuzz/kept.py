# SPDX-License-Identifier: Apache-2.0
"""Seeds that every run of the tests tries: each way to damage a file, and every fault so far."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from pathlib import Path

from tests.fuzz.example import Outcome

KEPT = Path(__file__).with_name("kept.toml")
ENOUGH = 8
"""Seeds of a reader that ``choose`` names; ``make explore`` tries thousands."""


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
        picked: dict[int, Outcome] = {}
        # First every kind of damage, then every file. What is accepted has passed every check.
        found.sort(key=lambda outcome: outcome.kind != "accepted")
        for part in (_kinds, _steps):
            done: set[str] = set()
            for outcome in found:
                if len(picked) < ENOUGH and not part(outcome) <= done:
                    done |= part(outcome)
                    picked[outcome.seed] = outcome
        lines += [entry(picked[seed]) for seed in sorted(picked)]
    return "".join(lines)


def _steps(outcome: Outcome) -> set[str]:
    """Files and what was done to each."""
    return set(outcome.mutation.split(", ")) - {"sealed"}


def _kinds(outcome: Outcome) -> set[str]:
    return {step.rpartition(": ")[2] for step in _steps(outcome)}
