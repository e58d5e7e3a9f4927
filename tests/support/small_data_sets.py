# SPDX-License-Identifier: Apache-2.0
"""A data set whose touches take a fraction of a second, and a sensor with a colour model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.datasets.plan import DatasetPlan
from taccel_lab.datasets.runner import DatasetOutcome, make_dataset
from taccel_lab.datasets.spec import DatasetSpec
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.presses import PHYSICS, Accuracy, PressMeshOptions
from taccel_lab.presses.mesh_options import OutlineMeshOptions
from taccel_lab.profile import (
    BackgroundBlock,
    CameraBlock,
    ColorBlock,
    PerturbationBlock,
    Provenance,
    SensorProfile,
    save_profile,
)
from taccel_lab.scene import Element
from taccel_lab.sensors.profile import catalogue_profile

QUICK = replace(
    PHYSICS[Accuracy.FAST],
    element=Element.LINEAR,
    mesh=PressMeshOptions(
        elements_per_radius=2.0, core=4, rings=6, layers=2,
        outline=OutlineMeshOptions(outer=4, layers=2),
    ),
)  # fmt: skip
"""Far too coarse for forces, which these tests do not look at closely."""
SIZE = (32, 24)
ASSUMED = Provenance(kind="assumed", method="made up", source="tests")


def small_profile() -> SensorProfile:
    """A flat pad with a camera of few pixels, random colours and a spread between units."""
    profile = catalogue_profile("flat_pad")
    grid = profile.grid()
    pitch = grid.mm_per_px_x * grid.width_px / SIZE[0]
    camera = CameraBlock(
        width_px=SIZE[0], height_px=SIZE[1], mm_per_px_x=pitch, mm_per_px_y=pitch,
        center_u_px=(SIZE[0] - 1) / 2, center_v_px=(SIZE[1] - 1) / 2, provenance=ASSUMED,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    config = ColorModelConfig(*SIZE, hidden=(8, 8))
    weights = {
        n: rng.normal(0, 0.5, s).astype(np.float32) for n, s in config.weight_shapes().items()
    }
    image = rng.uniform(60, 180, (SIZE[1], SIZE[0], 3)).astype(np.float32)
    profile = profile.with_block(camera)
    profile = profile.with_block(BackgroundBlock(provenance=ASSUMED), image)
    profile = profile.with_block(
        ColorBlock(architecture=config.to_dict(), provenance=ASSUMED), weights
    )
    measured = Provenance(kind="measured", method="made up", source="tests")
    return profile.with_block(
        PerturbationBlock(
            gain_rgb=(0.05, 0.05, 0.05), pivot_rgb=(120.0, 120.0, 120.0), noise_levels=0.5,
            mm_per_px_relative=0.02, young_modulus_relative=0.1, friction_coefficient=0.05,
            provenance=measured,
        )
    )  # fmt: skip


def table(profile: Path | str, **changes: Any) -> dict[str, Any]:
    """The file of a small data set as a table; ``changes`` replace entries of its tables."""
    found: dict[str, Any] = {
        "dataset": {"name": "small", "episodes": 6, "seed": 4, "view": 0.3},
        "sensors": [{"profile": str(profile)}],
        "objects": [{"tool": "sphere:2"}, {"tool": "sphere:3", "split": "test"}],
        "motions": [
            {"kind": "press", "depth_mm": [0.1, 0.4]},
            {"kind": "slip", "depth_mm": [0.1, 0.2], "shear_mm": [0.2, 0.4]},
        ],
        "output": {"episodes_per_part": 2, "block_steps": 2},
    }
    for name, value in changes.items():
        found[name] = {**found.get(name, {}), **value} if isinstance(value, dict) else value
    if "x_mm" in found["dataset"] and "view" not in changes["dataset"]:
        del found["dataset"]["view"]
    return found


def plan(profile: Path | str, base: Path | None = None, **changes: Any) -> DatasetPlan:
    spec = DatasetSpec.checked(table(profile, **changes), "small.toml")
    return DatasetPlan(spec, base or Path(), QUICK)


def make(
    profile: Path | str, out: Path, shard: tuple[int, int] = (1, 1), **more: Any
) -> DatasetOutcome:
    """Make the small data set in this process."""
    given = {"processes": 0} | {key: more.pop(key) for key in ("processes", "say") if key in more}
    return make_dataset(plan(profile, **more), out, source="small", shard=shard, **given)


def parts_of(root: Path) -> dict[str, bytes]:
    """Every file of every part, by its name below ``parts``."""
    parts = root / "parts"
    return {
        path.relative_to(parts).as_posix(): path.read_bytes()
        for path in sorted(parts.glob("[0-9]*/**/*"))
        if path.is_file()
    }


def saved_profile(folder: Path) -> Path:
    """The profile as a folder."""
    save_profile(small_profile(), folder)
    return folder
