# SPDX-License-Identifier: Apache-2.0
"""The suite ``fine_images``: images of textured objects from coarse gels, against a fine mesh.

A ball of 5 mm with a texture is pressed 0.15 mm deep into a pad of 12 x 12 x 4 mm (E 0.15 MPa, nu
0.46, no friction). The reference presses the textured surface itself, triangles 0.04 mm wide, into
a gel with nodes 0.04 mm apart; the others press a smooth ball into gels of a few thousand nodes and
show the texture by ``FineSurface``. Beside it what the gel alone shows. Images are of three lights
120 degrees apart, 25 degrees high, by Lambert, 180 levels for a face towards a light. Pixels count
where the reference differs from the untouched gel by more than 2 levels.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.results import ResultFile, note
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.benchmarks.textures import TEXTURES, carved_m
from taccel_lab.envs import PressEnv
from taccel_lab.envs.indenter import Indenter
from taccel_lab.envs.press_path import PressPath
from taccel_lab.errors import InputError
from taccel_lab.file_cache import cached_arrays
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Ball, Material, TriangleMesh
from taccel_lab.signals import SignalTactile
from taccel_lab.signals.deformed_face import DeformedFace
from taccel_lab.signals.fine_surface import FineSurface
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.texture import Texture
from taccel_lab.solvers import SolverConfig

BALL_MM, DEPTH_MM = 5.0, 0.15
PAD_MM, CORE_MM = (12.0, 4.0), 1.1
"""Width and thickness of the pad; half of the width that has small elements."""
MATERIAL = Material(1.5e5, 0.46)
GRID = PixelGrid(56, 56, 0.06, 0.06)
POINTS = 2
REFERENCE_MM, OBJECT_MM = 0.08, 0.04
"""Elements of the gel, two nodes each, and triangles of the object, in the reference."""
REFERENCE = SolverConfig(dhat_m=2e-6, relative_tolerance=1e-4)
COARSE = SolverConfig(dhat_m=1e-5, relative_tolerance=1e-4)
LIGHTS_DEG, LIGHT_HEIGHT_DEG, GAIN, AMBIENT = (90.0, 210.0, 330.0), 25.0, 180.0, 110.0
CHANGED_LEVELS = 2.0


@dataclass(frozen=True)
class FineImages(Suite):
    """Error of images, heights and forces of textured objects by nodes of the gel."""

    name: ClassVar[str] = "fine_images"
    what: ClassVar[str] = (
        "Textured balls: image, height and force of coarse gels with the contact solved on pixels, "
        "against a press of the texture itself into a fine mesh."
    )
    textures: tuple[str, ...] = tuple(TEXTURES)
    """knurl, thread, coin, text, fabric."""
    elements_mm: tuple[float, ...] = (0.8, 0.5, 0.35, 0.25)
    """Of the coarse gels under the ball, a point of the curve each."""
    reference_mm: float = REFERENCE_MM
    """Elements of the reference under the ball."""

    def settings(self) -> dict[str, Any]:
        return {
            "textures": self.textures,
            "elements_mm": self.elements_mm,
            "reference_mm": self.reference_mm,
            "ball_mm": BALL_MM,
            "depth_mm": DEPTH_MM,
        }

    def measure_rows(self, result: ResultFile) -> None:
        """A row a texture, then the mean of each element size over the textures."""
        unknown = [name for name in self.textures if name not in TEXTURES]
        if unknown:
            raise InputError(f"--textures are {', '.join(TEXTURES)}; got {', '.join(unknown)}")
        pictures: dict[str, list[np.ndarray]] = {}
        for name in self.textures:
            row = partial(measure, name, self.elements_mm, self.reference_mm, pictures)
            result.measure(name, row, describe)
        if result.rows:
            result.put("mean", means(result.rows))
            draw(result.rows, pictures, str(result.path.with_suffix(".png")))
            note(f"drew {result.path.with_suffix('.png')}")


# Gels and objects --------------------------------------------------------------------------------


def gel(element_mm: float) -> TetMesh:
    """A pad with small elements in the middle of its face, growing outwards and down."""
    half, thickness = PAD_MM[0] / 2, PAD_MM[1]
    core = max(1, round(CORE_MM / element_mm))
    inner = element_mm * np.arange(core + 1)
    outer = inner[-1] + _growing(element_mm, half - inner[-1])
    xy = np.concatenate([-outer[::-1], -inner[:0:-1], inner, outer])
    z = -np.concatenate([[0.0], _growing(0.8 * element_mm, thickness)])[::-1]
    mesh = block_mesh((len(xy) - 1, len(xy) - 1, len(z) - 1), (1.0, 1.0, 1.0))
    where = np.rint((mesh.nodes_m - [-0.5, -0.5, -1.0]) * [len(xy) - 1, len(xy) - 1, len(z) - 1])
    i, j, k = where.astype(int).T
    return replace(mesh, nodes_m=1e-3 * np.column_stack([xy[i], xy[j], z[k]]))


def _growing(first: float, length: float) -> np.ndarray:
    """Ends of steps, each about 1.8 times the one before, the first ``first``, over ``length``."""
    from scipy.optimize import brentq

    count = max(2, round(np.log1p(0.8 * length / first) / np.log(1.8)))

    def excess(growth: float) -> float:
        return first * float((growth ** np.arange(1, count + 1)).sum()) - length

    growth: Any = brentq(excess, 0.2, 20.0)
    return np.cumsum(first * growth ** np.arange(1, count + 1))


def textured_ball(texture: Texture) -> TriangleMesh:
    """The underside of the ball with its texture, as a closed mesh whose highest points at the
    middle are at the origin."""
    reach = 0.4 * BALL_MM
    t = 1e-3 * np.arange(-reach, reach + OBJECT_MM / 2, OBJECT_MM)
    x, y = np.meshgrid(t, t)
    z = 1e-3 * BALL_MM - np.sqrt((1e-3 * BALL_MM) ** 2 - x**2 - y**2) + carved_m(texture, x, y)
    low = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    under = np.concatenate([np.stack([a, d, b], axis=1), np.stack([a, c, d], axis=1)])
    rim = np.concatenate([at[0, :-1], at[:-1, -1], at[-1, :0:-1], at[:0:-1, 0]])
    top_m, count = z.max() + 5e-4, len(rim)
    top, after = len(low) + np.arange(count), np.roll(np.arange(count), -1)
    walls = [np.stack([rim, rim[after], top[after]], 1), np.stack([rim, top[after], top], 1)]
    lid = np.stack([top, top[after], np.full(count, len(low) + count)], axis=1)
    upper = np.column_stack([low[rim, :2], np.full(count, top_m)])
    vertices = np.concatenate([low, upper, [[0.0, 0.0, top_m]]])
    return TriangleMesh(vertices, np.concatenate([under, *walls, lid]))


# Presses -----------------------------------------------------------------------------------------


def press(mesh: TetMesh, indenter: Indenter, config: SolverConfig) -> tuple[PressEnv, float]:
    """A press in two steps, and the seconds that it took."""
    started = time.perf_counter()
    env = PressEnv(mesh, MATERIAL, indenter, np.zeros((1, 2)), config=config)
    if isinstance(indenter.shape, TriangleMesh):
        # Its highest points touch where the ball would, not where the first of them does.
        env.touch_m[:] = 0.0
    env.follow(PressPath(DEPTH_MM, step_mm=0.5 * DEPTH_MM))
    return env, time.perf_counter() - started


def reference(name: str, element_mm: float) -> dict[str, np.ndarray]:
    """Height [m], normals, force [N], nodes and seconds of the fine press; kept in the cache."""
    texture = TEXTURES[name]()

    kept = cached_arrays(
        "fine_presses",
        {
            "heights": texture.heights,
            "sizes_m": [texture.depth_m, texture.width_m, 1e-3 * element_mm, 1e-3 * OBJECT_MM],
            "press_mm": [BALL_MM, DEPTH_MM, CORE_MM, *PAD_MM],
            "version": 1,
        },
    )
    found = kept.read()
    if found is None:
        note(f"{name}: pressing the texture into a fine mesh, some minutes")
        indenter = Indenter("reference", textured_ball(texture))
        env, seconds = press(gel(element_mm), indenter, REFERENCE)
        height, slope = surface(env.mesh, env.positions[0])
        found = {
            "height_m": height,
            "slope": slope,
            "force_n": np.array(env.press_force[0, 2]),
            "nodes": np.array(env.mesh.node_count),
            "seconds": np.array(seconds),
        }
        kept.write(found)
    return found


def surface(
    mesh: TetMesh | QuadraticMesh, positions_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean height [m] and slope of the mean normal of each pixel, of the gel alone."""
    face = DeformedFace(mesh, GRID.refined(POINTS))
    samples = face.sample(wp.array(positions_m[None], dtype=wp.vec3d, device="cpu")).numpy()[0]
    height, normal = samples[..., 2], normals_from_slopes(samples[..., :2])
    shape = (GRID.height_px, POINTS, GRID.width_px, POINTS)
    mean = normal.reshape(*shape, 3).mean(axis=(1, 3))
    return height.reshape(shape).mean(axis=(1, 3)), -mean[..., :2] / mean[..., 2:]


def image(slope: np.ndarray) -> np.ndarray:
    """Levels of a surface in three lights, [row, column, 3]."""
    normals, low = normals_from_slopes(slope), np.radians(LIGHT_HEIGHT_DEG)
    turn = np.radians(LIGHTS_DEG)
    lights = np.stack([np.cos(low) * np.cos(turn), np.cos(low) * np.sin(turn)], axis=-1)
    shade = normals[..., :2] @ lights.T + np.sin(low) * (normals[..., 2:] - 1)
    return np.clip(AMBIENT + GAIN * shade, 0, 255)


# Figures -----------------------------------------------------------------------------------------


def measure(
    name: str,
    elements_mm: tuple[float, ...],
    reference_mm: float,
    pictures: dict[str, list[np.ndarray]],
) -> dict[str, Any]:
    """A row: errors of all element sizes; images of the reference, of the coarse gel with fine
    contact and of it alone go to ``pictures``."""
    texture, truth = TEXTURES[name](), reference(name, reference_mm)
    bare = np.zeros_like(truth["slope"])
    row: dict[str, Any] = {
        "texture": name,
        "reference": {key: float(truth[key]) for key in ("force_n", "nodes", "seconds")},
        "bare": score(truth, np.zeros_like(truth["height_m"]), bare),
        "curve": [],
    }
    shown = [image(truth["slope"])]
    for element_mm in elements_mm:
        indenter = Indenter("ball", Ball(1e-3 * BALL_MM), texture)
        env, seconds = press(gel(element_mm), indenter, COARSE)
        fine = FineSurface(env.solver, "ball", GRID, texture=texture, points=POINTS)
        signal = SignalTactile.from_solver(env.solver, GRID, fine=fine)
        read_s = []
        for _ in range(3):
            started = time.perf_counter()
            signal.update(env.state)
            arrays = [a.numpy()[0] for a in signal.read("height_m", "normals", "pressure_pa")]
            read_s.append(time.perf_counter() - started)
        height, normals, pressure = (array.astype(np.float64) for array in arrays)
        slope = -normals[..., :2] / normals[..., 2:]
        alone = surface(env.mesh, env.positions[0])
        row["curve"].append(
            {
                "element_mm": element_mm,
                "nodes": env.mesh.node_count,
                "press_s": seconds,
                "read_s": float(np.median(read_s)),
                "force_n": float(env.press_force[0, 2]),
                "fine_force_n": float(pressure.sum() * 1e-6 * GRID.mm_per_px_x * GRID.mm_per_px_y),
                "fine": score(truth, height, slope),
                "gel alone": score(truth, *alone),
            }
        )
        if element_mm == chosen(elements_mm):
            shown += [image(slope), image(alone[1])]
    pictures[name] = shown
    return row


def chosen(elements_mm: tuple[float, ...]) -> float:
    """The element size that pictures show: the one nearest to that of presses by default."""
    return min(elements_mm, key=lambda size: abs(size - 0.35))


def score(truth: dict[str, np.ndarray], height: np.ndarray, slope: np.ndarray) -> dict[str, float]:
    """Errors of a surface."""
    found, expected = image(slope), image(truth["slope"])
    untouched = image(np.zeros_like(slope))
    counted = np.abs(expected - untouched).max(axis=-1) > CHANGED_LEVELS
    error = (found - expected)[counted]
    return {
        "levels_l1": float(np.abs(error).mean()),
        "psnr_db": float(10 * np.log10(255**2 / (error**2).mean())),
        "height_rms_um": float(1e6 * np.sqrt(((height - truth["height_m"]) ** 2).mean())),
    }


def means(rows: list[dict[str, Any]]) -> list[dict[str, float]]:
    """Of each element size, over the textures."""
    found = []
    for points in zip(*(row["curve"] for row in rows), strict=True):
        line = {key: float(np.mean([p[key] for p in points])) for key in ("nodes", "press_s")}
        for kind in ("fine", "gel alone"):
            for key in points[0][kind]:
                line[f"{kind} {key}"] = float(np.mean([p[kind][key] for p in points]))
        force = [
            p["fine_force_n"] / r["reference"]["force_n"] for p, r in zip(points, rows, strict=True)
        ]
        line["fine_force_of_reference"] = float(np.mean(force))
        found.append(line)
    return found


def draw(rows: list[dict[str, Any]], pictures: dict[str, list[np.ndarray]], path: str) -> None:
    """Images of all textures, and the errors by nodes."""
    from matplotlib import pyplot as plt

    titles = ("fine mesh", "coarse, fine contact", "coarse gel alone")
    figure, axes = plt.subplots(
        len(rows), 4, figsize=(12, 2.9 * len(rows)), squeeze=False, layout="constrained"
    )
    for line, row in zip(axes, rows, strict=True):
        for ax, title, levels in zip(line, titles, pictures[row["texture"]], strict=False):
            ax.imshow(levels.astype(np.uint8))
            ax.set(title=f"{row['texture']}: {title}", xticks=[], yticks=[])
        nodes = [point["nodes"] for point in row["curve"]]
        for kind, mark in (("fine", "o-"), ("gel alone", "^:")):
            line[3].plot(nodes, [p[kind]["levels_l1"] for p in row["curve"]], mark, label=kind)
        line[3].set(xlim=(0, None), ylim=(0, None), xlabel="nodes", ylabel="error [levels]")
        line[3].legend()
    figure.savefig(path, dpi=80)
    plt.close(figure)


def describe(row: dict[str, Any]) -> str:
    """Lines for the person who waits."""
    whole = row["reference"]
    lines = [
        f"{row['texture']}: reference {whole['nodes']:.0f} nodes, {whole['force_n']:.4f} N, "
        f"{whole['seconds']:.0f} s; bare background {row['bare']['psnr_db']:.1f} dB"
    ]
    for point in row["curve"]:
        parts = ", ".join(
            f"{kind} {point[kind]['levels_l1']:.2f} levels {point[kind]['psnr_db']:.1f} dB "
            f"{point[kind]['height_rms_um']:.1f} um"
            for kind in ("fine", "gel alone")
        )
        lines.append(
            f"  {point['nodes']} nodes, {point['press_s']:.1f} + {point['read_s']:.2f} s, "
            f"{point['fine_force_n']:.4f} N: {parts}"
        )
    return "\n".join(lines)
