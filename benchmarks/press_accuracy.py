# SPDX-License-Identifier: Apache-2.0
"""Errors of presses with each accuracy: catalogue families x tools x depths x materials x friction.

    python -m taccel_lab.benchmarks.press_accuracy prepare FOLDER   meshes of all cases (needs the
    CAD) python -m taccel_lab.benchmarks.press_accuracy run FOLDER       the presses (needs Warp,
    numpy, scipy) python -m taccel_lab.benchmarks.press_accuracy table            what
    docs/verification.md quotes

Every case is pressed by the same path with a reference mesh and with each accuracy, off the mesh's
symmetry. Heights are compared on 160 pixels across the sensor's view, less those at rest: what a
mesh leaves out of the rest shape does not come from the mesh (``signals.rest_surface``). Pixels
where the gel stands steeper than 60 degrees are left out: on the sides of a dome heights along the
view are differences of where a facet happens to end.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.envs import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressEnv,
    PressPath,
    PressPhysics,
    layered_material,
    parse_indenter,
)
from taccel_lab.errors import SimulationError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.output import write_json
from taccel_lab.scene import Material, TriangleMesh
from taccel_lab.signals import SignalHeightMap

RESULT = Path(__file__).parent / "results" / "press_accuracy.json"
AT_MM = (0.7, -0.4)
DEPTHS_MM = (0.1, 0.6)
TOOLS = {
    "ball 1.5": "sphere:1.5",
    "ball 4": "sphere:4",
    "ball 8": "sphere:8",
    "roller": "roller:2x6",
    "punch": "cylinder:2",
    "edge": "edge:90x6",
    "STL triangle": "",
}
MATERIALS = (
    (0.46, 0.0),
    (0.40, 0.5),
    (0.499, 0.0),
    (0.46, 1.0),
    (0.40, 0.0),
    (0.49, 0.5),
    (0.499, 1.0),
)
"""Poisson's ratio and friction, in turn; each family begins one further on: every tool meets
all of them."""
REFERENCE = "converged"
SETTINGS: dict[str, PressPhysics] = {
    **{accuracy.value: PHYSICS[accuracy] for accuracy in (Accuracy.FAST, Accuracy.DEFAULT)},
    REFERENCE: PHYSICS[Accuracy.REFERENCE],
}
GRID_PX = 160
STEEPEST_DEG = 60.0


@dataclass(frozen=True)
class Case:
    """One press, without its mesh."""

    family: str
    tool: str
    depth_mm: float
    poisson_ratio: float
    friction: float
    young_moduli_pa: tuple[float, ...]
    """Of the layers."""
    view_px: tuple[int, int]
    mm_per_px: tuple[float, float]

    @property
    def name(self) -> str:
        return f"{self.family}_{self.tool.replace(' ', '')}_{self.depth_mm:g}"

    def grid(self) -> PixelGrid:
        """The view, on fewer pixels."""
        coarser = self.view_px[0] / GRID_PX
        rows = max(2, round(self.view_px[1] / coarser))
        return PixelGrid(GRID_PX, rows, *(coarser * size for size in self.mm_per_px))


def triangle_prism(side_m: float = 5e-3, height_m: float = 3e-3) -> TriangleMesh:
    """What a user's STL might be: a prism over a triangle, its flat side down."""
    angle = np.radians([90.0, 210.0, 330.0])
    corners = side_m / math.sqrt(3) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low, high = (np.column_stack([corners, np.full(3, z)]) for z in (-height_m / 2, height_m / 2))
    faces = [[0, 2, 1], [3, 4, 5]]
    for i in range(3):
        j = (i + 1) % 3
        faces += [[i, j, j + 3], [i, j + 3, i + 3]]
    return TriangleMesh(np.concatenate([low, high]), np.array(faces))


def tool(name: str) -> Indenter:
    """The indenter of a tool's name."""
    return parse_indenter(TOOLS[name]) if TOOLS[name] else Indenter(name, triangle_prism())


def cases() -> Iterator[Case]:
    """All cases of the catalogue."""
    from taccel_lab.sensors.profile import catalogue_profile
    from taccel_lab.sensors.registry import sensor_families

    for first, family in enumerate(sensor_families()):
        profile = catalogue_profile(family)
        grid, block = profile.grid(), profile.material
        for i, (name, depth_mm) in enumerate(itertools.product(TOOLS, DEPTHS_MM)):
            poisson_ratio, friction = MATERIALS[(first + i) % len(MATERIALS)]
            yield Case(
                family=family,
                tool=name,
                depth_mm=depth_mm,
                poisson_ratio=poisson_ratio,
                friction=friction,
                young_moduli_pa=tuple(s.young_modulus_pa for s in (block, *block.layers)),
                view_px=(grid.width_px, grid.height_px),
                mm_per_px=(grid.mm_per_px_x, grid.mm_per_px_y),
            )


def prepare(folder: Path) -> None:
    """Write the meshes of all cases, for a machine without the CAD."""
    from taccel_lab.sensors.press_mesh import press_mesh

    folder.mkdir(parents=True, exist_ok=True)
    for case in cases():
        contact = tool(case.tool).contact(case.depth_mm)
        arrays: dict[str, Any] = {"case": json.dumps(asdict(case))}
        for setting, physics in SETTINGS.items():
            mesh = press_mesh(case.family, {}, AT_MM, contact, physics.mesh)
            key = _keep_topology(folder, mesh)
            arrays[f"{setting} nodes_m"] = mesh.nodes_m.astype(np.float32)
            arrays[f"{setting} topology"] = key
        np.savez_compressed(folder / f"{case.name}.npz", **arrays)


def _keep_topology(folder: Path, mesh: TetMesh) -> str:
    """Meshes of one setting share their connectivity: it is written once."""
    import hashlib

    arrays = {
        "tets": mesh.tets,
        "faces": mesh.faces,
        "face_regions": mesh.face_regions,
        "tet_layers": mesh.tet_layers,
    }
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays.values()))
    path = folder / f"topology_{digest.hexdigest()[:16]}.npz"
    if not path.exists():
        np.savez_compressed(path, allow_pickle=False, **arrays)
    return path.name


def run(folder: Path, out: Path, device: str, seconds: float, part: tuple[int, int]) -> None:
    """Press all prepared cases, or every n-th of them, and write the rows; stops in good order
    after ``seconds``."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    started = time.perf_counter()
    rows: list[dict[str, Any]] = []
    document = {"run": describe_run(device), "settings": _settings(), "rows": rows}
    # In an order that is not that of families, so that a part of it says something about all.
    names = sorted(p.name for p in folder.glob("*.npz") if not p.name.startswith("topology"))
    first, every = part
    for name in sorted(names, key=lambda text: text[::-1])[first::every]:
        stored = dict(np.load(folder / name))
        case = Case(**json.loads(str(stored.pop("case"))))
        found = {key: _press(folder, stored, case, key, device) for key in SETTINGS}
        converged = found.pop(REFERENCE)
        for setting, pressed in found.items():
            rows.append(_row(case, setting, pressed, converged))
        write_json(out, document)
        print(f"{len(rows) // 2} {case.name} {time.perf_counter() - started:.0f} s", flush=True)
        if time.perf_counter() - started > seconds:
            break


def _settings() -> dict[str, Any]:
    return {name: physics.record() for name, physics in SETTINGS.items()}


@dataclass(frozen=True)
class Pressed:
    """What one press gave, or why it gave nothing."""

    cause: str = ""
    force_n: float = math.nan
    moved_m: np.ndarray | None = None
    """Height less that at rest [m], [height_px, width_px], NaN where the gel is steep."""
    force_error_n: float = math.nan
    height_error_m: float = math.nan
    residual: float = math.nan
    """Over the contact force."""
    nodes: int = 0
    newton: int = 0
    seconds: float = math.nan


def _press(
    folder: Path, stored: dict[str, np.ndarray], case: Case, setting: str, device: str
) -> Pressed:
    with np.load(folder / str(stored[f"{setting} topology"])) as topology:
        mesh = TetMesh(stored[f"{setting} nodes_m"].astype(np.float64), **dict(topology))
    layers = [Material(e, case.poisson_ratio) for e in case.young_moduli_pa]
    env = PressEnv(
        mesh,
        layered_material(layers, mesh),
        tool(case.tool),
        np.array([AT_MM]),
        friction_coefficient=case.friction,
        physics=SETTINGS[setting],
        device=device,
    )
    started = time.perf_counter()
    try:
        reports = env.follow(PressPath(case.depth_mm))
    except SimulationError as error:
        return Pressed(cause=str(error), nodes=env.mesh.node_count)
    seconds = time.perf_counter() - started
    heights = SignalHeightMap(env.mesh, case.grid(), device=device)
    heights.update(np.stack([env.mesh.nodes_m, env.positions[0]]))
    moved = heights.height_m[1] - heights.height_m[0]
    slope = np.hypot(*np.moveaxis(heights.slope[0], -1, 0))
    shown = slope <= math.tan(math.radians(STEEPEST_DEG))
    error = env.error_estimate()
    return Pressed(
        force_n=float(env.press_force[0, 2]),
        moved_m=np.where(shown, moved, np.nan),
        force_error_n=float(error.force_n[0]),
        height_error_m=float(error.height_m[0]),
        residual=float(reports[-1].residual_n[0] / max(reports[-1].contact_force_n[0], 1e-9)),
        nodes=env.mesh.node_count,
        newton=int(sum(report.newton_iterations[0] for report in reports)),
        seconds=seconds,
    )


def _row(case: Case, setting: str, pressed: Pressed, converged: Pressed) -> dict[str, Any]:
    row: dict[str, Any] = {
        **asdict(case),
        "setting": setting,
        "cause": pressed.cause or (converged.cause and f"converged run: {converged.cause}"),
    }
    if row["cause"] or pressed.moved_m is None or converged.moved_m is None:
        return row
    apart = pressed.moved_m - converged.moved_m
    return row | {
        "force_n": pressed.force_n,
        "converged_n": converged.force_n,
        "force_error": pressed.force_n / converged.force_n - 1,
        "estimated_force_error": pressed.force_error_n / abs(pressed.force_n),
        "height_rms_m": float(np.sqrt(np.nanmean(apart**2))),
        "estimated_height_rms_m": pressed.height_error_m,
        "residual": pressed.residual,
        "nodes": pressed.nodes,
        "converged_nodes": converged.nodes,
        "newton_iterations": pressed.newton,
        "seconds": pressed.seconds,
    }


def table(rows: Sequence[dict[str, Any]], setting: str = "default") -> str:
    """Markdown: a line a tool; errors as median and largest, and how often the estimate held."""
    lines = [
        "| tool, depth | cases | force: median, worst | heights: median, worst | "
        "within the estimate: force, heights |",
        "|---|---|---|---|---|",
    ]
    done = [row for row in rows if row["setting"] == setting and not row["cause"]]
    groups = [(name, depth) for name in TOOLS for depth in DEPTHS_MM]
    for name, depth in [*groups, ("all", 0.0)]:
        chosen = [r for r in done if name == "all" or (r["tool"], r["depth_mm"]) == (name, depth)]
        if not chosen:
            continue
        force = np.array([abs(row["force_error"]) for row in chosen])
        height = np.array([row["height_rms_m"] for row in chosen])
        held = force <= [row["estimated_force_error"] for row in chosen]
        held_height = height <= [row["estimated_height_rms_m"] for row in chosen]
        what = name if name == "all" else f"{name}, {depth:g} mm"
        lines.append(
            f"| {what} | {len(chosen)} | {np.median(force):.1%}, {force.max():.1%} | "
            f"{1e6 * np.median(height):.1f}, {1e6 * height.max():.1f} um | {held.mean():.0%}, "
            f"{held_height.mean():.0%} |"
        )
    failed = sum(bool(row["cause"]) for row in rows if row["setting"] == setting)
    lines += ["", f"{failed} of {len(done) + failed} cases did not converge."] if failed else []
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="errors of presses with each accuracy")
    parser.add_argument("what", choices=("prepare", "run", "table"))
    parser.add_argument("folder", type=Path, nargs="?", default=RESULT)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), metavar=("I", "N"))
    options = parser.parse_args(arguments)
    if options.what == "prepare":
        prepare(options.folder)
    elif options.what == "run":
        run(options.folder, options.out, options.device, options.seconds, tuple(options.part))
    else:
        print(table(json.loads(options.folder.read_text())["rows"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
