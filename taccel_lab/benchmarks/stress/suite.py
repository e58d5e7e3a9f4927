# SPDX-License-Identifier: Apache-2.0
"""The suite ``stress``: many cases in a few processes, or one again, step by step."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, ClassVar

from taccel_lab.benchmarks.results import ResultFile, Ticker, note
from taccel_lab.benchmarks.stress.families import FAMILIES, make_case
from taccel_lab.benchmarks.stress.pool import CaseId, run_all
from taccel_lab.benchmarks.stress.runner import SECONDS, run_case
from taccel_lab.benchmarks.stress.summary import GOOD, case_id, summarize, table
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError

SAVE_EVERY_S = 60.0


@dataclass(frozen=True)
class Stress(Suite):
    """Hundreds of random scenes over extremes; no failure may be silent (benchmarks/stress).

    The exit code is 1 when a case was silent or broken, or when too many stayed unsolved.
    """

    name: ClassVar[str] = "stress"
    what: ClassVar[str] = "Random scenes over extremes, each judged by independent referees."
    count: int = 200
    """Scenes."""
    seed: int = 0
    """Of the first scene; the same seed gives the same scenes."""
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
        if not 0 <= self.max_unsolved <= 1:
            raise InputError(f"--max-unsolved must be between 0 and 1, got {self.max_unsolved:g}")
        for name in self.families:
            if name not in FAMILIES:
                raise InputError(f"--families must be of {', '.join(FAMILIES)}; got {name!r}")
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

    def settings(self) -> dict[str, Any]:
        return {
            "count": self.count,
            "seed": self.seed,
            "budget_s": self.seconds,
            "jobs": self.jobs,
        }

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
