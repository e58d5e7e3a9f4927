# SPDX-License-Identifier: Apache-2.0
"""The table of planted faults fits the source, and its runner tells noticed from not noticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.__main__ import Mutants, plant
from tests.mutants.table import KINDS, ROOT, Fault, read_faults


def test_every_fault_can_be_planted() -> None:
    faults = read_faults()
    assert len({fault.id for fault in faults}) == len(faults) >= 60
    assert {fault.kind for fault in faults} == set(KINDS)
    for fault in faults:
        assert fault.planted(ROOT)
        assert all((ROOT / tests).exists() for tests in fault.tests), fault.id


@pytest.mark.thorough
@pytest.mark.parametrize(("claim", "noticed"), [("two() == 2", True), ("two() < 5", False)])
def test_a_planted_fault_is_noticed_or_not(tmp_path: Path, claim: str, noticed: bool) -> None:
    (tmp_path / "product.py").write_text("def two():\n    return 2\n")
    test = f"from product import two\n\n\ndef test_two():\n    assert {claim}\n"
    (tmp_path / "test_product.py").write_text(test)
    fault = Fault("three", "formula", "product.py", "return 2", "return 3", ("test_product.py",))
    outcome = plant(fault, tmp_path, Mutants(limit_s=60.0))
    assert (outcome.noticed, "test_two" in outcome.by) == (noticed, noticed)
    assert "return 2" in (tmp_path / "product.py").read_text()
