# SPDX-License-Identifier: Apache-2.0
"""What each setting costs in accuracy: force and markers of a press with shear, one at a time.

A ball of 4 mm radius goes 0.6 mm into a bonded gel of 16 x 16 x 4 mm and then 0.3 mm sideways, with
friction 0.5. Mesh, time step, dhat, kappa, the friction's eps and the tolerance are varied one at a
time; the error is that against the finest run of a series (both elements: against the finest
quadratic mesh). Orders are those of limit + factor size^order, fitted by least squares to the runs
within a tenth of the finest of their own series; where the misfit is large there is none.

The press is quasi-static, but for the time step: there the gel has mass and is pressed smoothly in
8 ms, with sliding of eps_v dt in each step. It is damped: nodes that come into contact one by one
set off waves of the shortest length, and without damping these hide any order of the time step.
Run from the repository root:

    python -m taccel_lab.benchmarks.convergence_study --out benchmarks/results
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.benchmarks.shear_press import (
    BALL_M,
    DENSITY,
    DEPTH_M,
    DURATION_S,
    FRICTION,
    MARKERS_M,
    POISSON,
    SHEAR_M,
    YOUNG_PA,
    Outcome,
    Press,
    run,
)
from taccel_lab.output import atomic_file, write_json
from taccel_lab.scene import Element, TimeScheme


@dataclass(frozen=True)
class Series:
    """Runs that differ in one setting, from coarse to fine."""

    name: str
    label: str
    sizes: list[float]
    """Setting of each run, made so that zero is exact."""
    presses: list[Press]
    reference: str = ""
    """Series whose last run is the reference; the own one when empty."""


def all_series(quick: bool) -> list[Series]:
    """What is varied."""
    base = Press()
    # The time step is studied on a coarse mesh, whose waves it can resolve.
    swing = replace(base, element=Element.LINEAR, dhat_m=2e-5, relative_tolerance=1e-7)
    linear, quadratic = (2, 3, 4, 6, 8), (2, 3, 4, 5)
    steps = [16, 32, 64, 128, 256, 512]
    dhats = [2e-4 * 0.5**k for k in range(9)]
    kappas = [0.01 * 4.0**k for k in range(8)]
    eps = [1e-4 * 0.25**k for k in range(9)]
    tolerances = [10.0**-k for k in range(1, 9)]
    if quick:
        linear, quadratic, steps = linear[:3], quadratic[:3], steps[:4]
        dhats, kappas, eps, tolerances = dhats[:4], kappas[:4], eps[:4], tolerances[:4]

    def meshes(element: Element, layers: tuple[int, ...]) -> tuple[list[float], list[Press]]:
        fine = Press(element=element, relative_tolerance=1e-5)
        return [4.0 / n for n in layers], [replace(fine, layers=n) for n in layers]

    def schemes(scheme: TimeScheme) -> tuple[list[float], list[Press]]:
        return [1e3 * DURATION_S / n for n in steps], [
            replace(swing, steps=n, scheme=scheme) for n in steps
        ]

    return [
        Series("mesh, quadratic", "layer thickness h [mm]", *meshes(Element.QUADRATIC, quadratic)),
        Series(
            "mesh, linear",
            "layer thickness h [mm]",
            *meshes(Element.LINEAR, linear),
            reference="mesh, quadratic",
        ),
        Series("dt, BDF2", "dt [ms]", *schemes(TimeScheme.BDF2)),
        Series("dt, Euler", "dt [ms]", *schemes(TimeScheme.EULER), reference="dt, BDF2"),
        Series(
            "dhat", "dhat [um]", [1e6 * d for d in dhats], [replace(base, dhat_m=d) for d in dhats]
        ),
        Series(
            "kappa",
            "Young's modulus / kappa",
            [1 / k for k in kappas],
            [replace(base, dhat_m=2e-5, kappa_over_young=k) for k in kappas],
        ),
        Series(
            "friction eps",
            "eps = eps_v dt [um]",
            [1e6 * e for e in eps],
            [replace(base, friction_eps_m=e) for e in eps],
        ),
        Series(
            "tolerance",
            "relative tolerance",
            tolerances,
            [replace(base, relative_tolerance=t) for t in tolerances],
        ),
    ]


def errors(outcomes: list[Outcome], exact: Outcome) -> dict[str, np.ndarray]:
    """Relative errors of each run; of the markers the largest, over the largest displacement."""
    scale = np.linalg.norm(exact.markers_m, axis=1).max()
    return {
        "normal": np.array([o.normal_n / exact.normal_n - 1 for o in outcomes]),
        "tangential": np.array([o.tangential_n / exact.tangential_n - 1 for o in outcomes]),
        "markers": np.array(
            [np.linalg.norm(o.markers_m - exact.markers_m, axis=1).max() / scale for o in outcomes]
        ),
    }


@dataclass(frozen=True)
class Fit:
    """values = limit + factor size^order, by least squares."""

    order: float
    limit_error: float
    """Error of the reference itself by this fit."""
    misfit: float
    """Root mean square of what is left over the spread of the values."""


def fitted(sizes: np.ndarray, values: np.ndarray, scale: float) -> Fit | None:
    """Fit the runs that are within a tenth of the finest; None without four of them or an order.

    ``values``: [run, n], of which only order and scale are common.
    """
    error = np.linalg.norm(values - values[-1], axis=1) / scale
    used = error < 0.1
    if used.sum() < 4:
        return None
    x, y = sizes[used], values[used]

    def solve(order: float) -> tuple[float, np.ndarray]:
        matrix = np.stack([np.ones_like(x), (x / x.max()) ** order], axis=1)
        found = np.linalg.lstsq(matrix, y, rcond=None)[0]
        return float(np.linalg.norm(y - matrix @ found)), found

    tried = np.arange(0.2, 5.0, 0.02)
    best = int(np.argmin([solve(o)[0] for o in tried]))
    if best in (0, len(tried) - 1):
        return None
    order = float(tried[best])
    rest, found = solve(order)
    return Fit(
        order=round(order, 2),
        limit_error=float(np.linalg.norm(values[-1] - found[0]) / scale),
        misfit=rest / float(np.linalg.norm(y - y.mean(axis=0))),
    )


def is_monotone(error: np.ndarray) -> bool:
    """Whether the size of the error never grows from coarse to fine; the reference is left out."""
    size = np.abs(error[np.abs(error) > 0])
    return bool((np.diff(size) <= 0).all())


def fits(series: Series, outcomes: list[Outcome]) -> dict[str, Fit | None]:
    """Of each quantity."""
    sizes, finest = np.array(series.sizes), outcomes[-1]
    markers = np.array([o.markers_m.ravel() for o in outcomes])
    # The largest displacement, over the root mean square that the norm of all of them is.
    scale = np.linalg.norm(finest.markers_m, axis=1).max() * np.sqrt(len(MARKERS_M))
    return {
        "normal": fitted(sizes, np.array([[o.normal_n] for o in outcomes]), abs(finest.normal_n)),
        "tangential": fitted(
            sizes, np.array([[o.tangential_n] for o in outcomes]), abs(finest.tangential_n)
        ),
        "markers": fitted(sizes, markers, float(scale)),
    }


def summary(series: Series, outcomes: list[Outcome], exact: Outcome) -> dict:
    """One series of the JSON."""
    error = errors(outcomes, exact)
    rows = []
    for i, (press, outcome) in enumerate(zip(series.presses, outcomes, strict=True)):
        row = asdict(outcome)
        del row["markers_m"], row["heights_m"]
        own = {f"{name}_error": float(values[i]) for name, values in error.items()}
        rows.append({"size": series.sizes[i]} | own | row | {"settings": asdict(press)})
    return {
        "what": series.label,
        "reference": series.reference or series.name,
        "fit": {n: asdict(f) if f else None for n, f in fits(series, outcomes).items()},
        "monotone": {name: is_monotone(e) for name, e in error.items()},
        "runs": rows,
    }


PANELS = [
    ("mesh, quadratic", "mesh, linear"),
    ("dt, BDF2", "dt, Euler"),
    ("dhat",),
    ("kappa",),
    ("friction eps",),
    ("tolerance",),
]


def plot(results: dict[str, dict], path: Path) -> None:
    """Errors of forces and markers by setting, a panel for each."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(13, 8), layout="constrained")
    colors = {"normal": "tab:blue", "tangential": "tab:orange", "markers": "tab:green"}
    for axis, names in zip(axes.ravel(), PANELS, strict=True):
        for name, style in zip(names, ("o-", "s--"), strict=False):
            rows, fit = results[name]["runs"], results[name]["fit"]
            for key, color in colors.items():
                points = [(row["size"], 100 * abs(row[f"{key}_error"])) for row in rows]
                points = [p for p in points if p[1] > 0]
                label = key if len(names) == 1 else f"{name.split(', ')[1]}: {key}"
                if fit[key] and fit[key]["misfit"] < 0.1:
                    label += f", order {fit[key]['order']:.1f}"
                axis.loglog(*zip(*points, strict=True), style, color=color, ms=4, label=label)
        axis.set(xlabel=results[names[0]]["what"], title=names[0].split(",")[0])
        axis.grid(True, lw=0.3)
        axis.legend(fontsize=8, loc="upper left")
        axis.xaxis.set_minor_formatter("")
    mesh_axis = axes[0, 0]
    mesh_axis.set_xticks([0.5, 1, 2], ["0.5", "1", "2"])
    for axis in axes[0, :2]:
        low, high = axis.get_ylim()
        axis.set_ylim(low / 8, high)
        axis.legend(fontsize=8, ncols=2, loc="lower center")
    for axis in axes[:, 0]:
        axis.set_ylabel("error against the finest [%]")
    with atomic_file(path) as target:
        fig.savefig(target, dpi=110)
        target.chmod(0o644)
    plt.close(fig)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--quick", action="store_true", help="coarse runs only")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    for element in Element:
        run(Press(element=element, layers=2, relative_tolerance=1e-2))  # compiles the kernels
    results: dict[str, dict] = {}
    last: dict[str, Outcome] = {}
    for series in all_series(options.quick):
        outcomes = [run(press) for press in series.presses]
        last[series.name] = outcomes[-1]
        exact = last[series.reference or series.name]
        result = results[series.name] = summary(series, outcomes, exact)
        for row in result["runs"]:
            print(
                f"{series.name:16s} {row['size']:9.3g}  {row['node_count']:6d} nodes  "
                f"normal {100 * row['normal_error']:+8.4f} %  "
                f"tangential {100 * row['tangential_error']:+8.4f} %  "
                f"markers {100 * row['markers_error']:8.4f} %  {row['seconds']:.1f} s",
                flush=True,
            )
        for name, fit in result["fit"].items():
            print(f"    {name}: monotone {result['monotone'][name]}, {fit}", flush=True)
    document = {
        "what": (__doc__ or "").split("\n")[0],
        "run": describe_run(),
        "press": {
            "ball_m": BALL_M,
            "depth_m": DEPTH_M,
            "shear_m": SHEAR_M,
            "friction": FRICTION,
            "young_pa": YOUNG_PA,
            "poisson_ratio": POISSON,
            "density_kg_m3": DENSITY,
        },
        "series": results,
    }
    write_json(options.out / "convergence_study.json", document)
    plot(results, options.out / "convergence_study.png")


if __name__ == "__main__":
    main()
