# SPDX-License-Identifier: Apache-2.0
"""What a bad reader does is noticed, in each of the ways in which readers are watched."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz import campaign, faulty_readers
from tests.fuzz.example import Outcome
from tests.fuzz.faulty_readers import FAULTS

_SEEDS = range(2)
NAMES = [name for name in FAULTS if name != "hangs"]


def _outcomes(
    names: list[str], folder: Path, limit_s: float = campaign.LIMIT_S
) -> dict[str, list[Outcome]]:
    found: dict[str, list[Outcome]] = {name: [] for name in names}
    examples, table = [(name, seed) for name in names for seed in _SEEDS], faulty_readers.__name__
    for outcome in campaign.run(examples, 1, folder, table=table, limit_s=limit_s):
        found[outcome.reader].append(outcome)
    return found


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Outcome]]:
    return _outcomes(NAMES, tmp_path_factory.mktemp("watch"))


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_a_bad_reader_is_noticed(name: str, found: dict[str, list[Outcome]]) -> None:
    assert sorted(outcome.seed for outcome in found[name]) == list(_SEEDS)
    # Some mutations leave the file as it is and put another one beside it.
    assert {outcome.kind for outcome in found[name]} - {"accepted"} == {FAULTS[name][1]}
    # What was done is told even by a process that died of it.
    assert all("a.bin: " in outcome.mutation for outcome in found[name])


@pytest.mark.slow
def test_a_reader_that_never_returns_is_noticed(tmp_path: Path) -> None:
    found = _outcomes(["hangs"], tmp_path, 20.0)["hangs"]
    assert [outcome.kind for outcome in found] == ["hang"] * 2


@pytest.mark.thorough
def test_the_fault_of_a_crash_or_an_exception_has_a_place(found: dict[str, list[Outcome]]) -> None:
    for name, place in (("raises", "KeyError"), ("crashes", "crash")):
        assert {outcome.where for outcome in found[name] if outcome.fault} == {place}
