# SPDX-License-Identifier: Apache-2.0
"""Time, iterations and error of the linear solvers on Newton-like systems.

    python -m taccel_lab.benchmarks.linear_solvers [--device cuda:0] [--out results.json] [--dumps
    folder]
        [--only peg]

Every variant is checked against a sparse direct solution of scipy, in the first and the last
environment, before it is timed: whole solves, on a GPU replays of a captured graph. Matrices and
loads are scaled from environment to environment, so that a mix-up would show.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.benchmarks.linear_systems import System, dumped, peg, slab, with_contact_in_pattern
from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.ipc.linear.arrow_cg import ArrowCG
from taccel_lab.ipc.linear.arrow_shared import ArrowShared
from taccel_lab.ipc.linear.block_cg import BlockCG
from taccel_lab.ipc.linear.pipelined_cg import PipelinedCG
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.output import write_json

TOLERANCES = (1e-2, 1e-4, 1e-6)
MAX_ITERATIONS = 3000
REPEATS = 15


@dataclass(frozen=True)
class Variant:
    """A way to solve: a method, with thread blocks of its own size."""

    method: str = "auto"
    lanes: int | None = None
    blocks: int | None = None
    cluster_rows: int | None = None

    def __str__(self) -> str:
        if self.blocks is not None:
            return f"pipelined {self.blocks}x{self.lanes} clusters {self.cluster_rows}"
        return self.method if self.lanes is None else f"{self.method} {self.lanes}"


def build(system: System, env_count: int, device: wp.Device, variant: Variant) -> LinearSystem:
    """The system in ``env_count`` environments: s H p = s^2 rhs with its factor s."""
    linear = LinearSystem(
        system.pattern,
        env_count,
        device,
        clusters=system.clusters,
        method=variant.method,
        extra_capacity=max(len(system.places), 1),
    )
    if variant.blocks is not None:
        assert variant.cluster_rows is not None
        linear._solver = PipelinedCG(
            linear, system.clusters, variant.lanes, variant.blocks, variant.cluster_rows
        )
    elif variant.lanes is not None:
        kind = {"cg": BlockCG, "arrow": ArrowCG, "arrow-shared": ArrowShared}[variant.method]
        linear._solver = kind(linear, system.clusters, variant.lanes)
    count = len(system.places)
    scales = scale_factors(env_count)
    linear.values.assign(scales[:, None, None, None] * system.values)
    linear.rhs.assign(scales[:, None, None] ** 2 * system.rhs)
    if count:
        linear.extra.places.assign(np.repeat(system.places[None], env_count, axis=0))
        linear.extra.values.assign(scales[:, None, None, None] * system.blocks)
        linear.extra.counts.assign(np.full(env_count, count, dtype=np.int32))
    return linear


def scale_factors(env_count: int) -> np.ndarray:
    """Factor s of each environment; its solution is s times that of the system."""
    return np.linspace(1.0, 2.0, env_count)


def direct(system: System) -> np.ndarray:
    """Reference solution [free_count, 3]; the same in every environment."""
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    factor = splu(csc_array(system.matrix()))
    matrix, b = system.matrix(), system.rhs.ravel()
    x = factor.solve(b)
    x += factor.solve(b - matrix @ x)
    return x.reshape(-1, 3)


def measure(linear: LinearSystem, active: wp.array) -> float:
    """Median time of a solve [ms]."""
    device = linear.device
    if device.is_cpu:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            linear.solve(active, MAX_ITERATIONS)
            times.append(1e3 * (time.perf_counter() - start))
        return float(np.median(times))
    with wp.ScopedCapture(device) as capture:
        linear.solve(active, MAX_ITERATIONS)
    times = []
    begin, end = (wp.Event(device, enable_timing=True) for _ in range(2))
    for _ in range(REPEATS):
        wp.record_event(begin)
        wp.capture_launch(capture.graph)
        wp.record_event(end)
        times.append(wp.get_event_elapsed_time(begin, end))
    return float(np.median(times[2:]))


def rows_of(
    system: System, env_count: int, device: wp.Device, variant: Variant, reference: np.ndarray
) -> Iterator[dict[str, Any]]:
    """Figures at each tolerance."""
    start = time.perf_counter()
    linear = build(system, env_count, device, variant)
    active = wp.full(env_count, 1, dtype=wp.int32, device=device)
    linear.tolerances.fill_(TOLERANCES[0])
    linear.solve(active, MAX_ITERATIONS)
    wp.synchronize_device(device)
    built = time.perf_counter() - start
    matrix, b = system.matrix(), system.rhs.ravel()
    for tolerance in TOLERANCES:
        linear.tolerances.fill_(tolerance)
        linear.solution.fill_(wp.vec3d(np.nan, np.nan, np.nan))
        linear.solve(active, MAX_ITERATIONS)
        report = linear.report()
        x = linear.solution.numpy() / scale_factors(env_count)[:, None, None]
        true = [
            np.linalg.norm(b - matrix @ x[env].ravel()) / np.linalg.norm(b)
            for env in (0, env_count - 1)
        ]
        yield {
            "system": system.name,
            "rows": system.pattern.free_count,
            "blocks": system.pattern.block_count,
            "extra_blocks": len(system.places),
            "environments": env_count,
            "variant": str(variant),
            "method": linear.describe(),
            "tolerance": tolerance,
            "milliseconds": measure(linear, active),
            "iterations": float(report.iterations.mean()),
            "residual": float(max(true)),
            "reported_residual": float(report.relative_residual.max()),
            "error": float(np.abs(x[-1] - reference).max() / np.abs(reference).max()),
            "breakdowns": int(report.breakdown.sum()),
            "seconds_to_build": built,
        }


def plan(device: wp.Device, dumps: Path | None) -> Iterator[tuple[System, int, Variant]]:
    """What is measured."""
    gpu = device.is_cuda
    small = [peg(), with_contact_in_pattern(peg())]
    large = [slab((20, 20, 5)), slab((25, 26, 8))]
    if dumps is not None:
        small += [dumped(path, 9) for path in dumps.glob("peg*.npz")]
        large += [dumped(path, 1) for path in sorted(dumps.glob("p[0-9]*.npz"))]
    methods = [Variant()] if gpu else [Variant("ssor"), Variant("cg"), Variant("pipelined")]
    for system in small:
        for env_count in (1, 256, 4096) if gpu else (1, 16):
            blocks = [
                Variant(method, lanes)
                for method in ("cg", "arrow", "arrow-shared")
                for lanes in (128, 256, 512)
            ]
            blocks = blocks if gpu else [Variant("arrow"), Variant("arrow-shared")]
            for variant in methods + blocks:
                yield system, env_count, variant
    for system in large:
        teams = [Variant("cg", 512)] + [
            Variant("pipelined", lanes, blocks, rows)
            for lanes, blocks, rows in (
                (512, 32, 0),
                (512, 32, 16),
                (512, 32, 32),
                (256, 32, 16),
                (256, 64, 0),
                (256, 64, 16),
                (512, 64, 16),
            )
        ]
        for variant in methods + (teams if gpu else []):
            yield system, 1, variant
        for env_count in (16, 256) if gpu else ():
            yield system, env_count, Variant()


def main() -> None:
    """Time the linear solvers and write a table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--device", default=None)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/linear_solvers.json"))
    parser.add_argument("--dumps", type=Path, help="folder with Newton systems written down")
    parser.add_argument("--only", default="", help="systems whose name contains this")
    args = parser.parse_args()
    wp.config.quiet = True
    device = wp.get_device(args.device)
    rows: list[dict[str, Any]] = []
    references: dict[str, np.ndarray] = {}
    print(f"{'system':24} {'envs':>5} {'variant':30} tol    ms        its   residual error")
    for system, env_count, variant in plan(device, args.dumps):
        if args.only not in system.name:
            continue
        if system.name not in references:
            references[system.name] = direct(system)
        for row in rows_of(system, env_count, device, variant, references[system.name]):
            rows.append(row)
            print(
                f"{row['system']:24} {env_count:5d} {row['variant']:30} {row['tolerance']:.0e} "
                f"{row['milliseconds']:9.3f} {row['iterations']:6.1f} {row['residual']:.1e} "
                f"{row['error']:.1e}" + (" BROKE" if row["breakdowns"] else ""),
                flush=True,
            )
        write_json(args.out, {"run": describe_run(str(device)), "rows": rows})
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
