# SPDX-License-Identifier: Apache-2.0
"""``python -m taccel_lab.benchmarks.stress run | replay FAMILY SEED | list``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from taccel_lab.benchmarks.stress import FAMILIES, RESULT, run, table
from taccel_lab.benchmarks.stress.case import make_case
from taccel_lab.benchmarks.stress.runner import SECONDS, run_case


def _replay(family: str, seed: int, device: str, seconds: float) -> int:
    import warp as wp

    wp.config.quiet = True
    _, parameters = make_case(family, seed)
    print(json.dumps(parameters, indent=2))

    def watch(step: int, report: Any, found: list) -> None:
        print(f"step {step}: {report.summary()}", flush=True)
        for finding in found:
            print(f"  {finding}", flush=True)

    result = run_case(family, seed, device, seconds, watch)
    print(f"{result['outcome']} {result['says']}".strip(), f"in {result['seconds']:.2f} s")
    print(f"residual over what is allowed: {result['residual_ratio']:.3g}")
    return 0 if result["outcome"] in ("converged", "refused") else 1


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m taccel_lab.benchmarks.stress", description=__doc__
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="budget of a case")
    commands = parser.add_subparsers(dest="command", required=True)
    many = commands.add_parser("run", help="many cases")
    many.add_argument("--count", type=int, default=400)
    many.add_argument("--seed", type=int, default=0)
    many.add_argument("--jobs", type=int, default=1)
    many.add_argument("--families", default="", help="names, separated by commas; all when empty")
    many.add_argument("--out", type=Path, default=RESULT)
    again = commands.add_parser("replay", help="one case, step by step")
    again.add_argument("family", help="a family, or FAMILY:SEED as in the result file")
    again.add_argument("seed", type=int, nargs="?")
    commands.add_parser("list", help="the families")
    return parser.parse_args()


def main() -> int:
    """Run what the command line asks for."""
    args = _arguments()
    if args.command == "list":
        for name, make in FAMILIES.items():
            print(f"{name:18s} {' '.join((make.__doc__ or '').split())}")
        return 0
    if args.command == "replay":
        family, _, number = args.family.partition(":")
        seed = args.seed if args.seed is not None else int(number or 0)
        return _replay(family, seed, args.device, args.seconds)
    names = args.families.split(",") if args.families else None
    record = run(args.count, args.seed, args.out, args.device, args.jobs, args.seconds, names)
    print(table(record["summary"]))
    return (
        0 if record["summary"]["total"]["silent"] + record["summary"]["total"]["broken"] == 0 else 1
    )


if __name__ == "__main__":
    raise SystemExit(main())
