# SPDX-License-Identifier: Apache-2.0
"""Damaged files are read, or refused in a sentence that names them; nothing else happens.

Every reader of users' files (``readers.py``) gets damaged samples, each drawn from a kept seed; a
process of its own watches memory, time and the files around. ``make explore`` tries new seeds.
"""

from __future__ import annotations

import pytest

from tests.fuzz import campaign
from tests.fuzz.example import Outcome
from tests.fuzz.kept import kept
from tests.fuzz.readers import READERS


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Outcome]]:
    found: dict[str, list[Outcome]] = {name: [] for name in READERS}
    # Some need a library that is not installed everywhere.
    examples = [example for example in kept() if example[0] in READERS]
    for outcome in campaign.run(examples, 1, tmp_path_factory.mktemp("fuzz")):
        found[outcome.reader].append(outcome)
    return found


@pytest.mark.thorough
@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_read_or_refused_in_a_sentence(
    reader: str, outcomes: dict[str, list[Outcome]]
) -> None:
    assert outcomes[reader], "no seed is kept"
    for outcome in outcomes[reader]:
        assert not outcome.fault, outcome
    # A sample that is always refused would test one check alone.
    assert any(outcome.kind == "accepted" for outcome in outcomes[reader])


@pytest.mark.thorough
def test_seeds_do_what_they_did_when_they_were_kept(outcomes: dict[str, list[Outcome]]) -> None:
    """A change of the mutations deals other damage to every seed: keep new ones then."""
    before = kept()
    for outcome in (outcome for found in outcomes.values() for outcome in found):
        assert outcome.mutation == before[outcome.reader, outcome.seed]
