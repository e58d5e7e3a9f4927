# SPDX-License-Identifier: Apache-2.0
"""The verdict says what the numbers say."""

from __future__ import annotations

from dataclasses import replace

from taccel_lab.report.model import Report, Target
from taccel_lab.report.values import look_up, report_values
from taccel_lab.report.verdict import Verdict, judge_targets, reach_verdict
from tests.report.sample_report import full_report, press


def _verdict(report: Report) -> Verdict:
    values = report_values(report)
    return reach_verdict(report, values, judge_targets(report, values))


def test_targets_are_judged_in_their_direction():
    report = full_report()
    psnr, disc, unknown = judge_targets(report, report_values(report))
    assert (psnr.met, disc.met, unknown.met) == (False, True, False)
    assert psnr.value == 33.3 and psnr.baseline == 21.0
    assert abs(psnr.shortfall - 0.7) < 1e-9 and disc.shortfall < 0
    assert unknown.value is None and unknown.shortfall is None
    assert (psnr.goal_text, disc.goal_text) == ("≥ 34.0 dB", "≤ 2.60 levels")


def test_a_shortfall_comes_with_number_and_cause():
    verdict = _verdict(full_report())
    assert not verdict.good and verdict.headline == "1 of 3 targets are met"
    assert (
        "Falls short: crop PSNR is 33.3 dB, 0.7 dB from the goal of ≥ 34.0 dB."
        in (verdict.sentences[0])
    )
    assert verdict.sentences[0].endswith("Likely cause: too dark.")
    assert verdict.sentences[1].startswith("Not measured: something else")
    assert "Met: L1 in the disc 2.50 levels (goal ≤ 2.60 levels)." in verdict.sentences
    assert any("12.3 dB closer" in sentence for sentence in verdict.sentences)
    assert "A remark." in verdict.sentences


def test_all_met_is_good():
    report = replace(full_report(), targets=(Target("mesh.min_dihedral_deg", "angle", 10, True),))
    verdict = _verdict(report)
    assert verdict.good and verdict.headline == "All 1 targets are met"


def test_trouble_in_the_simulation_spoils_the_verdict():
    report = full_report()
    target = (Target("mesh.min_dihedral_deg", "angle", 10, True),)
    pierced = replace(report.press, records=(press("press 7", 1.0, min_distance_m=0.0),))
    verdict = _verdict(replace(report, targets=target, press=pierced))
    assert not verdict.good and "trouble" in verdict.headline
    assert any("intersect" in sentence for sentence in verdict.sentences)


def test_a_rendering_worse_than_the_background_says_so():
    report = full_report()
    color = replace(report.color, heldout=replace(report.color.heldout, crop_psnr_db=19.0))
    verdict = _verdict(replace(report, color=color))
    assert any("2.0 dB further from the capture" in sentence for sentence in verdict.sentences)


def test_look_up_takes_numbers_only():
    values = {"a": {"b": 2, "c": "text", "d": None, "e": float("nan"), "f": True}}
    assert look_up(values, "a.b") == 2.0
    for key in ("a.c", "a.d", "a.e", "a.f", "a.b.c", "x", "a"):
        assert look_up(values, key) is None
