# SPDX-License-Identifier: Apache-2.0
"""Error rates that findings quote are those that were measured, and are quoted."""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.benchmarks.check_errors import error_rates
from taccel_lab.benchmarks.results import FOLDER, read_result
from taccel_lab.calibration.error_rates import RATES, quoted
from taccel_lab.calibration.result import Remark, Severity


def test_rates_are_those_of_the_results() -> None:
    result = read_result(FOLDER / "check_errors.json")
    assert result["complete"]
    assert error_rates(result["rows"]) == RATES


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
