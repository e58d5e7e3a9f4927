# SPDX-License-Identifier: Apache-2.0
"""A frictionless rigid ball pressed into a half-space, against Hertz: convergence of the solver.

    a = sqrt(R d),  F = 4/3 E* sqrt(R) d^1.5,  E* = E / (1 - nu^2),  p(r) = p0 sqrt(1 - r^2 / a^2)

for a rigid sphere of radius R at depth d [Johnson 1985, Contact Mechanics, section 4.2]. Mesh,
dhat and the size of the block are varied one at a time. Run from the repository root:

    python -m taccel_lab.benchmarks.hertz_convergence --out benchmarks/results
"""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import warp as wp

from taccel_lab.benchmarks.half_space_mesh import half_space_mesh
from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.geometry import Region
from taccel_lab.output import atomic_file, write_json
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state


@dataclass(frozen=True)
class HertzCase:
    """One press; a / R is 0.05, so that Hertz's parabola and his small strains hold."""

    cells: int = 6
    """Elements side by side from the axis to the contact radius."""
    element: Element = Element.LINEAR
    dhat_over_depth: float = 0.002
    domain_over_radius: float = 300.0
    """Radius of the block over the contact radius; its outside is fixed."""
    poisson_ratio: float = 0.3
    ball_radius_m: float = 1e-2
    depth_m: float = 2.5e-5
    young_pa: float = 1e5

    @property
    def contact_radius_m(self) -> float:
        """Hertz's contact radius [m]."""
        return float(np.sqrt(self.ball_radius_m * self.depth_m))

    @property
    def force_n(self) -> float:
        """Hertz's force [N]."""
        plane_modulus = self.young_pa / (1 - self.poisson_ratio**2)
        return 4 / 3 * plane_modulus * float(np.sqrt(self.ball_radius_m)) * self.depth_m**1.5

    @property
    def growth(self) -> float:
        """Ratio of neighbouring shells: about as long as wide, and finer with ``cells``.

        Quadratic tets follow the field far away in larger steps.
        """
        step = 1.2 if self.element is Element.QUADRATIC else 0.8
        return float(np.exp(step / self.cells))


@dataclass(frozen=True)
class HertzResult:
    """What a press gave, against Hertz."""

    force_n: float
    force_error: float
    """Force over Hertz's, less 1."""
    radius_m: float
    """Contact radius [m] from the second moment of the contact forces: sum f r^2 = 2/5 a^2 F."""
    outermost_m: float
    """Distance of the outermost node that carries force from the axis [m]."""
    element_m: float
    """Longest edge of a surface face in the contact [m]."""
    node_count: int
    newton_iterations: int
    residual_n: float
    min_distance_m: float
    seconds: float
    radii_m: np.ndarray
    """Distance of the loaded nodes from the axis [m]."""
    pressures_pa: np.ndarray
    """Contact force over area of the loaded nodes [Pa]."""


def press(case: HertzCase) -> HertzResult:
    """Press the ball to its depth in one step."""
    mesh = half_space_mesh(
        case.contact_radius_m,
        case.cells,
        case.domain_over_radius * case.contact_radius_m,
        case.growth,
    )
    body = SoftBody(mesh, Material(case.young_pa, case.poisson_ratio), element=case.element)
    scene = Scene(body, (KinematicBody(Ball(case.ball_radius_m)),))
    model = scene.finalize()
    dhat = case.dhat_over_depth * case.depth_m
    solver = SolverIPC(model, SolverConfig(dhat_m=dhat, absolute_tolerance_n=1e-12))

    def pose(gap_m: float) -> np.ndarray:
        return np.array([[[0.0, 0.0, case.ball_radius_m + gap_m, 0.0, 0.0, 0.0, 1.0]]])

    state = initial_state(model, pose(2 * dhat))
    report = solver.step(state, pose(-case.depth_m))
    if not report.converged.all():
        raise RuntimeError(f"the press did not converge: {report.summary()}")

    force = -solver.contact_gradient.numpy()[0, : model.soft_count]
    positions = state.positions.numpy()[0, : model.soft_count]
    size = np.linalg.norm(force, axis=1)
    loaded = np.flatnonzero(size > 1e-3 * size.max())
    radii = np.hypot(positions[:, 0], positions[:, 1])
    top = body.nodal_mesh.region_faces(Region.CONTACT)
    corners = positions[top[np.isin(top, loaded).any(axis=1)]]
    area = model.surface.node_areas.numpy()[0, : model.soft_count]
    total = -float(force[:, 2].sum())
    return HertzResult(
        force_n=total,
        force_error=total / case.force_n - 1,
        radius_m=float(np.sqrt(2.5 * (size * radii**2).sum() / size.sum())),
        outermost_m=float(radii[loaded].max()),
        element_m=float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()),
        node_count=model.soft_count,
        newton_iterations=int(report.newton_iterations[0]),
        residual_n=float(report.residual_n[0]),
        min_distance_m=float(report.min_distance_m[0]),
        seconds=report.seconds,
        radii_m=radii[loaded],
        pressures_pa=size[loaded] / area[loaded],
    )


def studies(cells: tuple[int, ...]) -> dict[str, list[HertzCase]]:
    """Cases of each series: linear and quadratic meshes, each for two Poisson's ratios; dhat and
    domain at one mesh."""
    base = HertzCase(cells=5)
    locking = [n for n in cells if n <= 8]
    quadratic = [n for n in (2, 3, 4) if 2 * n <= max(cells)]
    return {
        "mesh, nu 0.3": [HertzCase(cells=n) for n in cells],
        "mesh, nu 0.45": [HertzCase(cells=n, poisson_ratio=0.45) for n in locking],
        "quadratic, nu 0.3": [HertzCase(n, Element.QUADRATIC) for n in quadratic],
        "quadratic, nu 0.499": [
            HertzCase(n, Element.QUADRATIC, poisson_ratio=0.499) for n in quadratic[:-1]
        ],
        "dhat": [
            replace(base, dhat_over_depth=d) for d in (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
        ],
        "domain": [replace(base, domain_over_radius=s) for s in (10, 20, 40, 80, 160, 320, 640)],
    }


def figures(case: HertzCase, result: HertzResult) -> dict:
    """One row of the JSON."""
    row = asdict(result)
    del row["radii_m"], row["pressures_pa"]
    return {
        "case": asdict(case),
        "hertz": {"force_n": case.force_n, "radius_m": case.contact_radius_m},
        "result": row,
    }


def plot(series: dict[str, list[tuple[HertzCase, HertzResult]]], path: Path) -> None:
    """Error against element size, dhat and block size, and the pressure of the finest mesh."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
    mesh_axis, pressure_axis, dhat_axis, domain_axis = axes.ravel()
    for name, marker in (
        ("mesh, nu 0.3", "o"),
        ("mesh, nu 0.45", "s"),
        ("quadratic, nu 0.3", "v"),
        ("quadratic, nu 0.499", "^"),
    ):
        # By the distance of nodes: quadratic elements have some in the middle of their edges.
        halves = 2 if name.startswith("quadratic") else 1
        size = np.array([1 / (halves * case.cells) for case, _ in series[name]])
        error = np.array([100 * result.force_error for _, result in series[name]])
        mesh_axis.loglog(size, error, marker + "-", label=name.replace("mesh", "linear"))
    first = series["mesh, nu 0.3"][0]
    guide = np.array([1 / first[0].cells, 1 / 10])
    mesh_axis.loglog(
        guide, 60 * first[1].force_error * (guide / guide[0]) ** 2, "k:", label="slope 2"
    )
    mesh_axis.axhline(3, color="grey", lw=0.8)
    mesh_axis.set(xlabel="distance of nodes / contact radius", ylabel="force over Hertz [%]")
    mesh_axis.set_title("mesh (grey: 3 %)")
    mesh_axis.set_xticks([0.1, 0.15, 0.2, 0.3], ["0.1", "0.15", "0.2", "0.3"])
    mesh_axis.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    mesh_axis.minorticks_off()

    case, result = series["mesh, nu 0.3"][-1]
    a = case.contact_radius_m
    peak = 1.5 * case.force_n / (np.pi * a**2)
    r = np.linspace(0, 1, 200)
    pressure_axis.plot(result.radii_m / a, result.pressures_pa / 1e3, ".", ms=4, label="nodes")
    pressure_axis.plot(r, peak / 1e3 * np.sqrt(1 - r**2), "k-", lw=1, label="Hertz")
    pressure_axis.set(xlabel="distance from the axis / a", ylabel="contact pressure [kPa]")
    pressure_axis.set_title(f"pressure, {case.cells} elements along a")

    for axis, name, key, label in (
        (dhat_axis, "dhat", "dhat_over_depth", "dhat / depth"),
        (domain_axis, "domain", "domain_over_radius", "radius of the block / a"),
    ):
        x = [getattr(case, key) for case, _ in series[name]]
        axis.semilogx(x, [100 * result.force_error for _, result in series[name]], "o-")
        axis.set(xlabel=label, ylabel="force over Hertz [%]", title=f"{name}, 5 elements along a")
        axis.set_ylim(bottom=0)
    for axis in axes.ravel():
        axis.grid(True, which="both", lw=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend()
    with atomic_file(path) as target:
        fig.savefig(target, dpi=110)
    plt.close(fig)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--cells", type=int, nargs="+", default=[3, 4, 5, 6, 8, 10])
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    press(HertzCase(cells=2))  # compiles the kernels
    series: dict[str, list[tuple[HertzCase, HertzResult]]] = {}
    for name, cases in studies(tuple(options.cells)).items():
        series[name] = []
        for case in cases:
            result = press(case)
            series[name].append((case, result))
            print(
                f"{name:19s} cells {case.cells:2d}  dhat/d {case.dhat_over_depth:g}  "
                f"domain {case.domain_over_radius:g} a  nodes {result.node_count:6d}  "
                f"force {100 * result.force_error:+.2f} %  "
                f"a {result.radius_m / case.contact_radius_m:.4f}  {result.seconds:.1f} s",
                flush=True,
            )
    rows = {name: [figures(*pair) for pair in pairs] for name, pairs in series.items()}
    write_json(options.out / "hertz_convergence.json", {"run": describe_run(), "series": rows})
    plot(series, options.out / "hertz_convergence.png")


if __name__ == "__main__":
    main()
