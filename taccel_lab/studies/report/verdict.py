# SPDX-License-Identifier: Apache-2.0
"""The outcome of a study in words: what is best, what no design reaches, what went wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from taccel_lab.report.html import format_number
from taccel_lab.report.remark import Remark, Severity
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.answer import TELL_APART


@dataclass(frozen=True)
class StudyVerdict:
    """How a study ended."""

    good: bool
    """Whether it is through and some design keeps the bounds."""
    headline: str
    sentences: tuple[str, ...]
    """What was found."""
    remarks: tuple[Remark, ...]
    """What is wrong or missing."""


def study_verdict(outcome: StudyOutcome, values: dict[str, Any]) -> StudyVerdict:
    """Headline and sentences; good when the study is through and some design keeps the bounds."""
    counts, spec = values["counts"], outcome.study.spec
    remarks = []

    def remark(severity: Severity, code: str, message: str) -> None:
        remarks.append(Remark(severity, code, message))

    good = False
    if not counts["done"]:
        headline = "No design has figures"
        remark(Severity.ERROR, "no_figures", "No design has a figure; causes below.")
    elif spec.constraints and not counts["feasible"]:
        headline = "No design keeps the constraints"
        remark(Severity.ERROR, "no_feasible_design", _nearest_sentence(outcome, values))
    elif not outcome.complete:
        headline = f"{counts['rows']} of {counts['designs']} designs are done"
    else:
        headline = f"{counts['done']} designs compared"
        if spec.constraints:
            headline += f", {counts['feasible']} keep the constraints"
        good = True
    if not outcome.complete:
        text = "The study is not finished; the same command continues it."
        remark(Severity.WARNING, "not_finished", text)
    if counts["failed"]:
        lost = f"{counts['failed']} design{'s' if counts['failed'] > 1 else ''}"
        text = f"{lost} cannot be built or pressed; causes below."
        remark(Severity.WARNING, "failed_designs", text)
    if counts["broken"]:
        text = f"{counts['broken']} designs were lost to faults; the next run tries them again."
        remark(Severity.WARNING, "lost_designs", text)
    for text in _holes(outcome, values):
        remark(Severity.WARNING, "designs_without_figures", text)
    if values["gaps"]:
        text = "Some figures are missing; causes below."
        remark(Severity.WARNING, "missing_figures", text)
    sentences = _answer_sentences(outcome, values) if values["best"] else []
    if values["optimiser"]:
        sentences.append(
            f"The optimiser {spec.sweep.method} tried {counts['designs']} designs and stopped: "
            f"{values['optimiser']}."
        )
    sentences += _strongest(values)
    return StudyVerdict(good, headline, tuple(sentences), tuple(remarks))


def _answer_sentences(outcome: StudyOutcome, values: dict[str, Any]) -> list[str]:
    """The best design, the range of each of its parameters, and what limits it."""
    row = next(row for row in outcome.rows if row.id == values["best"][0])
    metric = values["goal_metric"]
    unit = values["metrics"][metric]["unit"]
    unit = "" if unit in ("", "1") else f" {unit}"
    found = values["answer"]
    ranges = ", ".join(
        f"{name} {format_number(low)} to {format_number(high)}"
        for name, (low, high) in found["intervals"].items()
        if low < high
    )
    limits = "; ".join(limit["text"] for limit in found["limits"])
    return [
        f"The {values['goal']}, {format_number(row.figures[metric])}{unit}, "
        f"has {values['names'][row.id]}.",
        f"Range of the answer: {ranges}."
        if ranges
        else f"All other designs are over {100 * TELL_APART:g} % worse.",
        f"Limited by {limits}." if limits else "No constraint and no range limits it.",
    ]


def _nearest_sentence(outcome: StudyOutcome, values: dict[str, Any]) -> str:
    nearest = values["nearest"]
    if nearest is None:
        return "No design has all the figures that the constraints are about."
    bounds = {c.metric: c.text() for c in outcome.study.spec.constraints}
    missed = "; ".join(
        f"{bounds[name]} is missed by {format_number(excess)} {values['metrics'][name]['unit']}"
        for name, excess in nearest["violations"].items()
    )
    return f"Nearest comes {values['names'][nearest['design']]}: {missed}."


def _holes(outcome: StudyOutcome, values: dict[str, Any]) -> list[str]:
    """What designs without figures take from the means of a grid."""
    lacking = {name: found["lacking"] for name, found in values["sensitivities"].items()}
    most = max(lacking.values(), default=0)
    if outcome.study.spec.sweep.kind != "grid" or not most:
        return []
    metrics = ", ".join(name for name, count in lacking.items() if count == most)
    return [
        f"{most} of {values['counts']['designs']} designs have no {metrics}. Means over a "
        "parameter compare only designs that have a figure at each of its values with all other "
        "parameters the same; the sensitivities say how many those are."
    ]


def _strongest(values: dict[str, Any]) -> list[str]:
    """Which parameter moves the goal's metric most."""
    if not values["goal"]:
        return []
    metric = values["goal_metric"]
    effects = values["sensitivities"][metric]["effects"]
    known = {n: e["elasticity"] for n, e in effects.items() if e["elasticity"] is not None}
    if not known:
        return []
    name = max(known, key=lambda key: abs(known[key]))
    return [
        f"{name} moves {metric} most: one percent more of it changes it by {known[name]:+.2f} "
        "percent."
    ]
