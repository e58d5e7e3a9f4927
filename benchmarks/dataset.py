# SPDX-License-Identifier: Apache-2.0
"""The suite ``dataset``: touches a second, and their images to disk, as data sets make them.

Balls come down on a flat pad, each in a place of its own, and shear; images of 320x240 px by a
colour network of random weights, markers, patch forces, wrenches and estimated errors, with the
physics of ``press``. Neither profiles nor their schema are needed, nor CAD kernels: warp, numpy,
scipy and torch alone run it. Where zarr is installed arrays are written as data sets are; else raw,
which the result says.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.images import background, color_model
from taccel_lab.benchmarks.results import ResultFile
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.cad.mesh.gel_mesh import gel_mesh
from taccel_lab.datasets.channels import channels_of
from taccel_lab.datasets.motion import Motion
from taccel_lab.datasets.part import PartData, write_arrays
from taccel_lab.datasets.placing import Placing
from taccel_lab.datasets.plan import Part
from taccel_lab.datasets.sensor import Sensor
from taccel_lab.datasets.simulate import Bench, joined, simulate_touches
from taccel_lab.datasets.touch import Touch
from taccel_lab.envs import PHYSICS, Accuracy, parse_indenter
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.scene import Material
from taccel_lab.sensors.registry import sensor_family

SIZE = (320, 240)
CHANNELS = ("rgb", "depth_mm", "markers_px", "patch_forces_n")
BLOCK_STEPS = 8


@dataclass(frozen=True)
class DatasetSpeed(Suite):
    """Images a second to disk of touches that are simulated side by side."""

    name: ClassVar[str] = "dataset"
    what: ClassVar[str] = "Touches simulated, drawn at 320x240 and written: images a second."
    touches: tuple[int, ...] = (8,)
    """Touches side by side, a row each."""
    accuracy: str = "default"
    """fast, default or reference, as of ``press``."""

    def settings(self) -> dict[str, Any]:
        return {
            "touches": self.touches,
            "accuracy": self.accuracy,
            "size": SIZE,
            "channels": CHANNELS,
            "written_by": "zarr" if find_spec("zarr") else "numpy, raw",
        }

    def measure_rows(self, result: ResultFile) -> None:
        """A row for each number of touches; kernels are compiled before."""
        if self.accuracy not in list(Accuracy):
            raise InputError(f"accuracy must be fast, default or reference; got {self.accuracy}")
        measure(1, self, Motion("press", 0.1))
        for count in self.touches:
            result.measure(
                f"{count} touches",
                lambda count=count: measure(count, self, Motion("shear", 0.6, 0.4)),
                describe,
            )


def describe(row: dict[str, Any]) -> str:
    """A line for people."""
    return (
        f"{row['images_per_s']:.2f} images/s to disk ({row['simulated_s']:.1f} s simulated and "
        f"drawn, {row['written_s']:.2f} s written), {row['stopped']} stopped"
    )


def flat_sensor() -> Sensor:
    """A flat pad of the catalogue with a colour network."""
    parameters = sensor_family("flat_pad").parameters()
    pad = parameters.pad()
    width_mm = 0.9 * float(np.ptp(pad.bounds_mm()[:, 0]))
    grid = PixelGrid(*SIZE, width_mm / SIZE[0], width_mm / SIZE[0])
    gel = parameters.layer_materials()[0]
    material = Material(gel.young_modulus_pa, gel.poisson_ratio)
    return Sensor(
        name="flat_pad",
        digest="",
        pad=pad,
        mesh=gel_mesh(pad),
        material_of=lambda mesh: material,
        friction_coefficient=0.5,
        grid=grid,
        camera=grid,
        color=(color_model(grid), background(grid)),
    )


def measure(count: int, suite: DatasetSpeed, motion: Motion) -> dict[str, Any]:
    """Make ``count`` touches once, and write them to a folder that goes away."""
    sensor, ball = flat_sensor(), parse_indenter("sphere:3")
    physics = PHYSICS[Accuracy(suite.accuracy)]
    rng = np.random.default_rng(5)
    begun = time.perf_counter()
    touches = []
    for number in range(count):
        placing = Placing(*rng.uniform(-2.0, 2.0, 2).tolist())
        touches.append(
            Touch(
                number,
                placing.mesh(sensor.pad, ball, motion.depth_mm, physics.mesh),
                placing.frame(sensor.pad, ball),
                motion.commands(),
                friction=float(rng.uniform(0.3, 0.8)),
                young_modulus_factor=float(rng.uniform(0.8, 1.2)),
            )
        )
    meshed = time.perf_counter()
    channels = channels_of(CHANNELS)
    bench = Bench(sensor, ball, physics, channels, device=suite.device)
    records = simulate_touches(touches, bench)
    wp.synchronize()
    simulated = time.perf_counter()
    data = PartData(
        Part(0, 0, 0, tuple(range(count)), count * (motion.step_count + 1)),
        channels,
        joined(records, channels),
        {},
        [(record.nodes_m, record.faces) for record in records],
        np.stack([record.gel_from_press for record in records]),
    )
    with tempfile.TemporaryDirectory() as folder:
        _write(Path(folder), data)
        size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    ended = time.perf_counter()
    return {
        "touches": count,
        "images": data.step_count,
        "images_per_s": data.step_count / (ended - begun),
        "meshed_s": meshed - begun,
        "simulated_s": simulated - meshed,
        "written_s": ended - simulated,
        "bytes": size,
        "stopped": sum(bool(record.cause) for record in records),
    }


def _write(folder: Path, data: PartData) -> None:
    if find_spec("zarr") is not None:
        write_arrays(folder / "data.zarr", data, BLOCK_STEPS, {})
        return
    for name, array in data.arrays.items():
        np.save(folder / f"{name}.npy", array)
