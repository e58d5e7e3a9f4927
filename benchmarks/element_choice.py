# SPDX-License-Identifier: Apache-2.0
"""Linear against quadratic tets: error of the force and run time of a press, by Poisson's ratio.

A frictionless ball of 4 mm radius goes 0.2, 0.6 and 1 mm into a bonded gel of 24 x 24 x 4.25 mm,
on meshes that are refined alike in all directions. The reference is the finest quadratic mesh of
the same Poisson's ratio; the difference to the mesh before it says how far that is converged. Run
from the repository root:

    python -m taccel_lab.benchmarks.element_choice --out benchmarks/results
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.cad.mesh.gel_mesh import FocusOptions, focused_gel_mesh
from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.envs import PHYSICS, Accuracy, PressEnv, parse_indenter
from taccel_lab.output import atomic_file, write_json
from taccel_lab.scene import Element, Material

DEPTHS_MM = (0.2, 0.6, 1.0)
POISSON_RATIOS = (0.45, 0.49, 0.499)
LEVELS = {Element.LINEAR: (4, 6, 8, 12), Element.QUADRATIC: (2, 3, 4, 6)}
"""Layers of elements in the gel; quadratic meshes of half as many have the same nodes."""
YOUNG_PA = 1.5e5


@dataclass(frozen=True)
class PressFigures:
    """One press of the ball down to the last depth."""

    element: str
    poisson_ratio: float
    layers: int
    node_count: int
    element_count: int
    forces_n: list[float]
    """At each depth."""
    cpu_seconds: float
    """Processor time of all steps, kernels compiled before: one thread, whatever else runs."""
    newton_iterations: int
    cg_iterations: int


def press(element: Element, layers: int, poisson_ratio: float) -> PressFigures:
    """Press the ball into the gel, one step a depth."""
    mesh = focused_gel_mesh(
        GelPad(
            length_x_mm=24.0,
            length_y_mm=24.0,
            corner_radius_mm=1.5,
            thickness_mm=4.25,
            window_x_mm=18.0,
            window_y_mm=18.0,
        ),
        FocusOptions(
            at_mm=(0.0, 0.0),
            radius_mm=3.5,
            size_mm=1.4 / layers,
            core=2 * layers,
            rings=max(5, round(2.3 * layers)),
            layers=layers,
            layer_ratio=1.15,
        ),
    )
    env = PressEnv(
        mesh,
        Material(YOUNG_PA, poisson_ratio),
        parse_indenter("sphere:4.0"),
        np.zeros((1, 2)),
        physics=replace(PHYSICS[Accuracy.DEFAULT], element=element),
    )
    reports, forces = [], []
    started = time.process_time()
    for depth in DEPTHS_MM:
        reports.append(env.move_to(depth))
        forces.append(float(env.wrench[0, 2]))
    spent = time.process_time() - started
    return PressFigures(
        element=element.value,
        poisson_ratio=poisson_ratio,
        layers=layers,
        node_count=env.model.soft_count,
        element_count=mesh.tet_count,
        forces_n=forces,
        cpu_seconds=round(spent, 3),
        newton_iterations=int(sum(r.newton_iterations[0] for r in reports)),
        cg_iterations=int(sum(r.cg_iterations[0] for r in reports)),
    )


def with_errors(runs: list[PressFigures]) -> list[dict]:
    """Rows of one Poisson's ratio with their errors against its finest quadratic mesh."""
    finest = max((r for r in runs if r.element == Element.QUADRATIC), key=lambda r: r.node_count)
    reference = np.array(finest.forces_n)
    rows = []
    for run in runs:
        error = np.array(run.forces_n) / reference - 1
        rows.append(asdict(run) | {"force_error": [round(float(e), 5) for e in error]})
    return rows


def plot(rows: list[dict], path: Path) -> None:
    """Error at the last depth against run time, a panel for each Poisson's ratio."""
    import matplotlib.pyplot as plt

    ratios = sorted({row["poisson_ratio"] for row in rows})
    fig, axes = plt.subplots(
        1, len(ratios), figsize=(4.2 * len(ratios), 4), sharey=True, layout="constrained"
    )
    for axis, ratio in zip(np.atleast_1d(axes), ratios, strict=True):
        for element, marker, color in (
            (Element.LINEAR, "o", "tab:orange"),
            (Element.QUADRATIC, "s", "tab:blue"),
        ):
            own = [r for r in rows if (r["element"], r["poisson_ratio"]) == (element, ratio)]
            own = [r for r in own if np.abs(r["force_error"]).max() > 0]
            seconds = [r["cpu_seconds"] for r in own]
            error = [100 * np.abs(r["force_error"]).max() for r in own]
            axis.loglog(seconds, error, marker + "-", color=color, label=f"{element} tets")
            for row, x, y in zip(own, seconds, error, strict=True):
                axis.annotate(
                    f"{row['node_count']:,}", (x, y), (4, 4), textcoords="offset points", size=7
                )
        axis.axhline(3, color="grey", lw=0.8)
        axis.set(xlabel="processor time of the press [s]", title=f"Poisson's ratio {ratio:g}")
        axis.grid(True, which="both", lw=0.3)
    first = np.atleast_1d(axes)[0]
    first.set_ylabel("largest error of the force [%]  (grey: 3 %)")
    first.set_yticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
    first.legend()
    fig.suptitle("Ball of 4 mm radius, 1 mm into a bonded layer of 4.25 mm; labels: nodes")
    with atomic_file(path) as target:
        fig.savefig(target, dpi=110)
    plt.close(fig)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--layers", type=int, default=12, help="finest linear mesh")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    rows: list[dict] = []
    for element in Element:
        press(element, 2, 0.4)  # compiles the kernels
    for ratio in POISSON_RATIOS:
        runs = []
        for element, levels in LEVELS.items():
            limit = options.layers // (2 if element is Element.QUADRATIC else 1)
            runs += [press(element, n, ratio) for n in levels if n <= limit]
        for row in with_errors(runs):
            rows.append(row)
            errors = ", ".join(f"{100 * e:+.2f} %" for e in row["force_error"])
            print(
                f"nu {ratio:g}  {row['element']:9s} {row['layers']:2d} layers  "
                f"{row['node_count']:6d} nodes  {errors}  {row['newton_iterations']} Newton  "
                f"{row['cg_iterations']} CG  {row['cpu_seconds']:.2f} s",
                flush=True,
            )
    result = {
        "what": (__doc__ or "").split("\n")[0],
        "run": describe_run(),
        "settings": {"depths_mm": DEPTHS_MM, "young_pa": YOUNG_PA, "dhat_mm": 0.02},
        "presses": rows,
    }
    write_json(options.out / "element_choice.json", result)
    plot(rows, options.out / "element_choice.png")


if __name__ == "__main__":
    main()
