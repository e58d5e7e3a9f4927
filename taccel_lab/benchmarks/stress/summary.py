# SPDX-License-Identifier: Apache-2.0
"""Counts and the table of many cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

GOOD = ("converged", "refused")
"""Outcomes that are right."""
LISTED = 20
"""How many of the slowest cases are kept."""


def case_id(result: dict[str, Any]) -> str:
    """How to name a case in ``replay``."""
    return f"{result['family']}:{result['seed']}"


def summarize(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Figures over all cases and by family; see ``table``."""
    families = sorted({result["family"] for result in results})
    by_family = {
        name: _figures([result for result in results if result["family"] == name])
        for name in families
    }
    bad = [result for result in results if result["outcome"] not in GOOD]
    slowest = sorted(results, key=lambda result: -result.get("processor_seconds", 0.0))[:LISTED]
    return {
        "total": _figures(results),
        "families": by_family,
        "referees": Counter(name for r in results for name in r.get("referees", [])),
        "failing": [_brief(result) for result in bad],
        "slowest": [_brief(result) for result in slowest],
    }


def _brief(result: dict[str, Any]) -> dict[str, Any]:
    says = "; ".join(filter(None, [result.get("says", ""), *result.get("findings", [])[:3]]))
    return {
        "case": case_id(result),
        "outcome": result["outcome"],
        "says": says,
        "newton_iterations": max(result.get("newton_iterations", []), default=0),
        "processor_seconds": result.get("processor_seconds", 0.0),
    }


def _figures(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    newton = np.array(_all(results, "newton_iterations"), dtype=float)
    parts = np.array(_all(results, "substeps"), dtype=int)
    seconds = np.array([result.get("processor_seconds", 0.0) for result in results])
    outcomes = Counter(result["outcome"] for result in results)
    return {
        "cases": len(results),
        "outcomes": dict(outcomes.most_common()),
        "converged": outcomes["converged"],
        "refused": outcomes["refused"],
        "failed": sum(n for name, n in outcomes.items() if name.isupper()),
        "budget": outcomes["budget"],
        "silent": outcomes["silent"],
        "broken": outcomes["error"] + outcomes["died"],
        "steps": len(newton),
        "steps_in_parts": int((parts > 1).sum()),
        "newton_median": float(np.median(newton)) if len(newton) else 0.0,
        "newton_p95": float(np.percentile(newton, 95)) if len(newton) else 0.0,
        "newton_max": float(newton.max(initial=0.0)),
        "balanced_steps": sum(result.get("balanced_steps", 0) for result in results),
        "residual_ratio_max": max((r.get("residual_ratio", 0.0) for r in results), default=0.0),
        "processor_s_median": float(np.median(seconds)) if len(seconds) else 0.0,
        "processor_s_max": float(seconds.max(initial=0.0)),
        "processor_s": float(seconds.sum()),
    }


def _all(results: Iterable[dict[str, Any]], name: str) -> list:
    return [value for result in results for value in result.get(name, [])]


_HEAD = (
    "| family | cases | converged | refused rightly | failed with a cause | out of time "
    "| silent | broken | steps (in parts) | Newton a step: median / p95 / max "
    "| processor seconds a case: median / max |",
    "|---|" + "--:|" * 10,
)


def _line(name: str, row: dict[str, Any]) -> str:
    causes = {cause: n for cause, n in row["outcomes"].items() if cause.isupper()}
    failed = ", ".join(f"{n} {cause}" for cause, n in causes.items()) or "0"
    return (
        f"| {name} | {row['cases']} | {row['converged']} | {row['refused']} | {failed} "
        f"| {row['budget']} | {row['silent']} | {row['broken']} "
        f"| {row['steps']} ({row['steps_in_parts']}) "
        f"| {row['newton_median']:.0f} / {row['newton_p95']:.0f} / {row['newton_max']:.0f} "
        f"| {row['processor_s_median']:.2f} / {row['processor_s_max']:.1f} |"
    )


def total_table(summary: dict[str, Any]) -> str:
    """Markdown: one row over all cases. A step counts once in each environment."""
    return "\n".join([*_HEAD, _line("**all**", summary["total"])])


def table(summary: dict[str, Any]) -> str:
    """Markdown: a row a family, then what failed. A step counts once in each environment."""
    families = [_line(name, row) for name, row in summary["families"].items()]
    lines = [*_HEAD, *families, _line("**all**", summary["total"])]
    if summary["referees"]:
        said = ", ".join(f"{name} {count}" for name, count in summary["referees"].items())
        lines += ["", f"Referees that objected (cases): {said}."]
    if summary["failing"]:
        lines += ["", "| case | outcome | Newton iterations | what |", "|---|---|--:|---|"]
        for item in summary["failing"]:
            says = item["says"].replace("|", "/")
            row = f"| `{item['case']}` | {item['outcome']} | {item['newton_iterations']} | {says} |"
            lines.append(row)
    return "\n".join(lines)
