# SPDX-License-Identifier: Apache-2.0
"""``python -m tests.fuzz``: damaged files that were never tried before, given to every reader.

``make explore`` runs it. Ctrl-C ends it with what has been found so far.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path

from tests.fuzz.campaign import LIMIT_S, run
from tests.fuzz.example import Outcome
from tests.fuzz.kept import KEPT, choose, entry
from tests.fuzz.readers import READERS

_HOW_TO_KEEP = f"""
To keep one: mend the reader, then add its line to
{KEPT}
so that it is tried in every run of the tests."""


def main() -> int:
    options = _options()
    names = [n for n in READERS if any(fnmatch(n, p) for p in options.readers.split(","))]
    if not names:
        sys.exit(f"no reader {options.readers!r}; there are {', '.join(READERS)}")
    first = int(time.time()) if options.first is None else options.first
    seeds = range(first, first + options.count)
    print(f"{len(names)} readers, seeds {seeds[0]} to {seeds[-1]}", flush=True)
    found: dict[str, list[Outcome]] = {name: [] for name in names}
    begun = time.monotonic()
    options.output.mkdir(parents=True, exist_ok=True)
    faults = options.output / "faults.toml"
    faults.write_text("")
    examples = [(name, seed) for name in names for seed in seeds]
    try:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            for outcome in run(examples, options.jobs, Path(folder), limit_s=options.limit_s):
                of_reader = found[outcome.reader]
                of_reader.append(outcome)
                if outcome.fault:
                    with faults.open("a", encoding="utf-8", errors="backslashreplace") as file:
                        file.write(_described(outcome))
                _tick(outcome.reader, len(of_reader), len(seeds))
                if len(of_reader) == len(seeds):
                    print(_row(outcome.reader, of_reader, time.monotonic() - begun), flush=True)
    except KeyboardInterrupt:
        print("\ninterrupted; what was found so far:", flush=True)
        for name, outcomes in found.items():
            if 0 < len(outcomes) < len(seeds):
                print(_row(name, outcomes, time.monotonic() - begun))
    everything = [outcome for outcomes in found.values() for outcome in outcomes]
    if options.choose:
        print(choose(everything))
    return _conclude(everything, faults)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--readers", default="*", help="names or patterns, joined by commas")
    parser.add_argument("--count", type=int, default=2000, help="examples of each reader")
    parser.add_argument("--first", type=int, help="first seed; the time when left out")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="for some twenty examples")
    parser.add_argument("--output", type=Path, default=Path("out/explore"), help="for bad seeds")
    parser.add_argument("--choose", action="store_true", help="also print seeds worth keeping")
    return parser.parse_args()


def _tick(name: str, done: int, total: int) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{name}: {done}/{total}\x1b[K" + ("\r\x1b[K" if done == total else ""))
        sys.stderr.flush()


def _row(name: str, outcomes: list[Outcome], seconds: float) -> str:
    kinds = Counter(outcome.kind for outcome in outcomes)
    accepted, refused = kinds.pop("accepted", 0), kinds.pop("refused", 0)
    faults = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "no faults"
    return (
        f"{name:18} {len(outcomes):6} examples {accepted:6} accepted {refused:6} refused  "
        f"{faults} (at {seconds:.0f} s)"
    )


def _described(fault: Outcome) -> str:
    lines = f"{fault.kind} {fault.where}: {fault.message[:300]}".splitlines()
    return "".join(f"# {line}\n" for line in lines) + entry(fault)


def _conclude(everything: list[Outcome], path: Path) -> int:
    faults = [outcome for outcome in everything if outcome.fault]
    print(f"{len(everything)} examples, {len(faults)} faults")
    if not faults:
        return 0
    groups: dict[tuple[str, str, str], list[Outcome]] = {}
    for fault in faults:
        groups.setdefault((fault.reader, fault.kind, fault.where), []).append(fault)
    for (reader, kind, where), group in sorted(groups.items(), key=lambda item: -len(item[1])):
        seeds = ", ".join(str(fault.seed) for fault in group[:5])
        said = repr(group[0].message[:200])
        print(f"{reader}: {len(group)} x {kind} {where} (seeds {seeds}): {said}")
    print(f"seeds: {path}{_HOW_TO_KEEP}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
