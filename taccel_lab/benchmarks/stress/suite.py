# SPDX-License-Identifier: Apache-2.0
"""The suite ``stress``: many cases in a few processes, their counts and table, or one case again,
step by step."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.results import ResultFile, Suite, Ticker, note
from taccel_lab.benchmarks.stress.families import FAMILIES, make_case
from taccel_lab.benchmarks.stress.runner import SECONDS, CaseId, run_all, run_case
from taccel_lab.errors import InputError
from taccel_lab.guards import require_known, require_range
from taccel_lab.report.markdown import markdown_table

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
    "family", "cases", "converged", "refused rightly", "failed with a cause", "out of time",
    "silent", "broken", "steps (in parts)", "Newton a step: median / p95 / max",
    "processor seconds a case: median / max",
)  # fmt: skip


def _cells(name: str, row: dict[str, Any]) -> tuple[Any, ...]:
    causes = [f"{n} {cause}" for cause, n in row["outcomes"].items() if cause.isupper()]
    return (
        *(name, row["cases"], row["converged"], row["refused"], ", ".join(causes) or "0"),
        *(row["budget"], row["silent"], row["broken"]),
        f"{row['steps']} ({row['steps_in_parts']})",
        f"{row['newton_median']:.0f} / {row['newton_p95']:.0f} / {row['newton_max']:.0f}",
        f"{row['processor_s_median']:.2f} / {row['processor_s_max']:.1f}",
    )


def total_table(summary: dict[str, Any]) -> str:
    """Markdown: one row over all cases. A step counts once in each environment."""
    return markdown_table(_HEAD, [_cells("**all**", summary["total"])])


def table(summary: dict[str, Any]) -> str:
    """Markdown: a row a family, then what failed. A step counts once in each environment."""
    families = [_cells(name, row) for name, row in summary["families"].items()]
    parts = [markdown_table(_HEAD, [*families, _cells("**all**", summary["total"])])]
    if summary["referees"]:
        said = ", ".join(f"{name} {count}" for name, count in summary["referees"].items())
        parts.append(f"Referees that objected (cases): {said}.")
    if summary["failing"]:
        names = ("case", "outcome", "newton_iterations", "says")
        rows = [[str(item[name]) for name in names] for item in summary["failing"]]
        cells = [(f"`{case}`", *rest, says.replace("|", "/")) for case, *rest, says in rows]
        parts.append(markdown_table(("case", "outcome", "Newton iterations", "what"), cells))
    return "\n\n".join(parts)


SAVE_EVERY_S = 60.0


@dataclass(frozen=True)
class Stress(Suite):
    """Hundreds of random scenes over extremes; no failure may be silent.

    The exit code is 1 when a case was silent or broken, or when too many stayed unsolved.
    """

    name: ClassVar[str] = "stress"
    what: ClassVar[str] = "Random scenes over extremes, each judged by independent referees."
    count: int = 200
    """Scenes."""
    seed: int = 0
    """Seed of the first scene; the same seed gives the same scenes."""
    families: tuple[str, ...] = ()
    """Kinds of scenes. Default: all."""
    jobs: int = 1
    """Processes at once."""
    seconds: float = SECONDS
    """Processor time after which a scene is given up."""
    max_unsolved: float = 0.2
    """Part of the scenes that may fail with a cause or run out of time."""
    replay: str = ""
    """Run one scene again instead, step by step: FAMILY:SEED, as in the result."""

    def run(self) -> None:
        require_range("--max-unsolved", self.max_unsolved, 0, 1)
        for name in self.families:
            require_known("family", name, FAMILIES)
        if self.replay:
            self._run_again()
            return
        summary = self.measure().get("summary")
        print(table(summary))
        total = summary["total"]
        unsolved = total["failed"] + total["budget"]
        if unsolved > self.max_unsolved * total["cases"]:
            note(
                f"{unsolved} of {total['cases']} scenes stayed unsolved; "
                f"{self.max_unsolved:.0%} may"
            )
            raise SystemExit(1)
        if total["silent"] + total["broken"]:
            raise SystemExit(1)

    def _run_again(self) -> None:
        """Print one case step by step; exit code 1 unless it went as it should."""
        import warp as wp

        wp.config.log_level = wp.LOG_WARNING
        family, _, seed = self.replay.partition(":")
        if family not in FAMILIES or not seed.isdecimal():
            known = ", ".join(FAMILIES)
            raise InputError(f"--replay takes FAMILY:SEED of {known}; got {self.replay!r}")
        _, parameters = make_case(family, int(seed))
        print(json.dumps(parameters, indent=2))

        def watch(step: int, report: Any, found: list) -> None:
            print(f"step {step}: {report.summary()}", flush=True)
            for finding in found:
                print(f"  {finding}", flush=True)

        result = run_case(family, int(seed), self.device, self.seconds, watch)
        print(f"{result['outcome']} {result['says']}".strip(), f"in {result['seconds']:.2f} s")
        print(f"residual over what is allowed: {result['residual_ratio']:.3g}")
        if result["outcome"] not in ("converged", "refused"):
            raise SystemExit(1)

    def measure_rows(self, result: ResultFile) -> None:
        """Run the cases; files are written anew now and then."""
        ids = case_ids(self.count, self.seed, self.families)
        finished: list[dict[str, Any]] = []
        saved = time.perf_counter()
        running = run_all(ids, self.device, self.jobs, self.seconds)
        try:
            with closing(running):
                ticker = Ticker("stress")
                for case in running:
                    finished.append(case)
                    if case["outcome"] not in GOOD:
                        note(f"{case_id(case)}: {case['outcome']}")
                    ticker("cases", len(finished), len(ids))
                    if time.perf_counter() - saved > SAVE_EVERY_S:
                        _write(result, ids, finished)
                        saved = time.perf_counter()
                    if len(finished) < len(ids) and result.deadline.passed:
                        break
        finally:
            _write(result, ids, finished)


def case_ids(count: int, seed: int, names: Sequence[str] = ()) -> list[CaseId]:
    """``count`` cases over all families in turn; the first has ``seed``, the next of a family the
    following ones."""
    names = list(names) or list(FAMILIES)
    return [(names[i % len(names)], seed + i // len(names)) for i in range(count)]


def _write(result: ResultFile, ids: list[CaseId], finished: list[dict[str, Any]]) -> None:
    """The cases so far, a row a family."""
    order = {case: number for number, case in enumerate(ids)}
    finished.sort(key=lambda case: order[(case["family"], case["seed"])])
    summary = summarize(finished)
    rows = [{"family": name, **row} for name, row in summary["families"].items()]
    result.replace(rows, summary=summary, cases=finished)
