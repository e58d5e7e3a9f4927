# SPDX-License-Identifier: Apache-2.0
"""Counts, tables and the picture of many cases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

GOOD = ("converged", "refused")
"""Outcomes that are right."""
WRONG = ("silent", "error", "died")
"""Outcomes that no scene may have."""
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


def table(summary: dict[str, Any]) -> str:
    """Markdown: a row a family, then what failed. A step counts once in each environment."""
    lines = [
        "| family | cases | converged | refused rightly | failed with a cause | out of time "
        "| silent | broken | steps (in parts) | Newton a step: median / p95 / max "
        "| processor seconds a case: median / max |",
        "|---|" + "--:|" * 10,
    ]
    for name, row in [*summary["families"].items(), ("**all**", summary["total"])]:
        causes = {cause: n for cause, n in row["outcomes"].items() if cause.isupper()}
        failed = ", ".join(f"{n} {cause}" for cause, n in causes.items()) or "0"
        lines.append(
            f"| {name} | {row['cases']} | {row['converged']} | {row['refused']} | {failed} "
            f"| {row['budget']} | {row['silent']} | {row['broken']} "
            f"| {row['steps']} ({row['steps_in_parts']}) "
            f"| {row['newton_median']:.0f} / {row['newton_p95']:.0f} / {row['newton_max']:.0f} "
            f"| {row['processor_s_median']:.2f} / {row['processor_s_max']:.1f} |"
        )
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


def plot(summary: dict[str, Any], results: Sequence[dict[str, Any]], out: Path) -> None:
    """A PNG: outcomes by family, and Newton iterations of all steps by family."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(summary["families"])[::-1]
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 0.3 * len(names) + 1.6), sharey=True, layout="constrained"
    )
    colours = {
        "converged": "#4c9f70",
        "refused": "#9cc5a1",
        "failed": "#e0a030",
        "budget": "#b0b0b0",
        "silent": "#c0392b",
        "broken": "#6c3483",
    }
    places, start = np.arange(len(names)), np.zeros(len(names))
    for kind, colour in colours.items():
        widths = np.array([summary["families"][name][kind] for name in names], dtype=float)
        if widths.any():
            left.barh(places, widths, left=start, color=colour, label=kind)
        start += widths
    left.set_yticks(places, names)
    left.set_xlabel("cases")
    left.set_ylim(-0.6, len(names) - 0.4)
    left.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=6, frameon=False, fontsize=8)
    for place, name in zip(places, names, strict=True):
        mine = [result for result in results if result["family"] == name]
        newton = np.array(_all(mine, "newton_iterations"), dtype=float) + 1
        spread = np.random.default_rng(0).uniform(-0.3, 0.3, len(newton))
        right.plot(newton, place + spread, ".", ms=3, alpha=0.4, color="#34495e")
    right.set_xscale("log")
    right.set_xlabel("Newton iterations of a step, one more")
    for axis in (left, right):
        axis.spines[["top", "right"]].set_visible(False)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=130)
    plt.close(figure)
