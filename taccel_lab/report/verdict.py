# SPDX-License-Identifier: Apache-2.0
"""The verdict in words: what is met, what falls short, by how much and why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from taccel_lab.report.model import Report, Target
from taccel_lab.report.values import look_up


@dataclass(frozen=True)
class TargetResult:
    """A target with what was measured."""

    target: Target
    value: float | None
    """None when the report holds no such figure."""
    baseline: float | None
    """The bare background's figure where there is one."""

    @property
    def met(self) -> bool:
        if self.value is None:
            return False
        reaches = self.value >= self.target.goal
        return reaches if self.target.at_least else self.value <= self.target.goal

    def text(self, value: float | None) -> str:
        """A number with the target's digits and unit."""
        if value is None:
            return "not measured"
        return f"{value:.{self.target.digits}f} {self.target.unit}".strip()

    @property
    def goal_text(self) -> str:
        return f"{'≥' if self.target.at_least else '≤'} {self.text(self.target.goal)}"

    @property
    def shortfall(self) -> float | None:
        """Distance to the goal, positive when it is missed; None when not measured."""
        if self.value is None:
            return None
        missing = self.target.goal - self.value
        return missing if self.target.at_least else -missing


@dataclass(frozen=True)
class Verdict:
    """Headline and sentences."""

    good: bool
    headline: str
    sentences: tuple[str, ...]


def judge_targets(report: Report, values: dict[str, Any]) -> list[TargetResult]:
    """Look up every target of the report."""
    return [
        TargetResult(
            target,
            look_up(values, target.key),
            look_up(values, target.key.replace("color.heldout.", "color.background_only."))
            if target.key.startswith("color.heldout.")
            else None,
        )
        for target in report.targets
    ]


def reach_verdict(report: Report, values: dict[str, Any], results: list[TargetResult]) -> Verdict:
    """Say in words what the numbers say."""
    trouble = _physics_trouble(values)
    met = [result for result in results if result.met]
    missed = [result for result in results if not result.met]
    sentences = [_missed_sentence(result) for result in missed]
    if met:
        sentences.append("Met: " + "; ".join(map(_met_phrase, met)) + ".")
    sentences += _color_sentences(values) + trouble + _physics_sentences(values)
    sentences += _detection_sentences(values) + list(report.remarks)
    if not results:
        headline = "No targets were set"
    elif not missed:
        headline = f"All {len(results)} targets are met"
    else:
        headline = f"{len(met)} of {len(results)} targets are met"
    if trouble:
        headline += ", and the simulation has trouble"
    return Verdict(not missed and not trouble, headline, tuple(sentences))


def _met_phrase(result: TargetResult) -> str:
    return f"{result.target.label} {result.text(result.value)} (goal {result.goal_text})"


def _missed_sentence(result: TargetResult) -> str:
    label, cause = result.target.label, result.target.cause
    if result.value is None:
        sentence = f"Not measured: {label} (goal {result.goal_text})."
    else:
        sentence = (
            f"Falls short: {label} is {result.text(result.value)}, "
            f"{result.text(abs(result.shortfall or 0.0))} from the goal of {result.goal_text}."
        )
    return f"{sentence} Likely cause: {cause}" if cause else sentence


def _color_sentences(values: dict[str, Any]) -> list[str]:
    color = values["color"]
    heldout, background = color["heldout"], color["background_only"]
    gain = heldout["crop_psnr_db"] - background["crop_psnr_db"]
    sentences = [
        f"On {color['heldout_count']} frames that the fit never saw, the rendered image is "
        f"{abs(gain):.1f} dB {'closer to' if gain > 0 else 'further from'} the capture than the "
        f"bare background ({heldout['crop_psnr_db']:.1f} against "
        f"{background['crop_psnr_db']:.1f} dB), and the error in the contact disc is "
        f"{heldout['disc_l1']:.2f} levels instead of {background['disc_l1']:.1f}."
    ]
    if color["frames"]:
        worst = color["frames"][0]
        sentences.append(
            f"The worst frame is {worst['name']} with {worst['crop_psnr_db']:.1f} dB in the crop."
        )
    sentences.append(
        f"Captures differ from the background by {color['noise_floor_l1']:.1f} levels even far "
        "from the contact: a whole-image error much below that takes a model of how the "
        "background drifts."
    )
    return sentences


def _physics_trouble(values: dict[str, Any]) -> list[str]:
    if values["press"]["smallest_distance_m"] <= 0:
        return ["Gel and indenter intersect in at least one press."]
    return []


def _physics_sentences(values: dict[str, Any]) -> list[str]:
    press = values["press"]
    if press["smallest_distance_m"] <= 0:
        return []
    count = len(press["records"]) or 1
    worst = max(record["residual_n"] for record in (press, *press["records"]))
    return [
        f"{'The press' if count == 1 else f'All {count} presses'} converged without an "
        f"intersection: the largest residual is {worst:.1e} N, the smallest distance "
        f"{press['smallest_distance_m'] * 1e6:.2g} µm, and a step takes "
        f"{press['seconds_per_step']:.2f} s and {press['newton_iterations']:.1f} Newton iterations."
    ]


def _detection_sentences(values: dict[str, Any]) -> list[str]:
    detection = values["detection"]
    if detection is None or detection["center_error_px"] is None:
        return []
    return [
        f"Contact circles were found without help in {detection['found']} of "
        f"{detection['count']} frames, off the labels by "
        f"{detection['center_error_px']['median']:.1f} px in the centre and "
        f"{detection['radius_error_px']['median']:.1f} px in the radius (medians)."
    ]
