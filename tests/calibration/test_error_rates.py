# SPDX-License-Identifier: Apache-2.0
"""Error rates that findings quote are those that were measured, and are quoted."""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.benchmarks.results import FOLDER, read_result
from taccel_lab.calibration.error_rates import RATES, quoted
from taccel_lab.calibration.result import Remark, Severity


def test_rates_are_those_of_the_results() -> None:
    """Counts over all sets; of balls that are stated wrongly, sets count."""
    result = read_result(FOLDER / "check_errors.json")
    assert result["complete"]
    rows = result["rows"]
    good = [row for row in rows if row["case"] == "good"]
    for code, rate in RATES.items():
        if code in ("wrong_ball_radius", "ball_too_small"):
            factors = (0.5, 0.7) if code == "wrong_ball_radius" else (0.5,)
            cases = {f"ball stated {factor:g} times as large" for factor in factors}
            tried = [row["by"] for row in rows if row["case"] in cases]
            assert (rate.found, rate.spoiled) == (sum(code in by for by in tried), len(tried))
            continue
        spoiled = [row for row in rows if row.get("code") == code]
        assert rate.good_named == sum(len(row["by_code"][code]) for row in good), code
        assert rate.found == sum(row["named"] for row in spoiled), code
        assert rate.spoiled == sum(row["count"] for row in spoiled), code


def test_good_presses_are_hardly_named() -> None:
    for code, rate in RATES.items():
        assert rate.good >= (100 if rate.of == "presses" else 5), code
        assert rate.good_named <= 0.02 * rate.good, code


def test_a_finding_quotes_its_rates_and_others_stay_as_they_are() -> None:
    finding = Remark(Severity.WARNING, "other_ball", "a ball is wrong", ("p",))
    message = quoted(finding).message
    assert message.startswith("a ball is wrong. On published sets this names ")
    assert f"{RATES['other_ball'].good_named} of {RATES['other_ball'].good} good" in message
    in_brackets = replace(finding, message="a ball (of two) is wrong (look at it)")
    assert quoted(in_brackets).message.startswith(f"{in_brackets.message}. On published")
    other = Remark(Severity.INFO, "one_background", "one")
    assert quoted(other) == other
