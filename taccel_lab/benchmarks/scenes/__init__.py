# SPDX-License-Identifier: Apache-2.0
"""The scenes by name; a module each, read on demand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module

from taccel_lab.benchmarks.scenes.base import BenchScene, SceneOptions
from taccel_lab.errors import InputError
from taccel_lab.guards import require_known

SCENES = {
    "peg": "peg",
    "press_239": "drag",
    "press_2005": "drag",
    "press_2005_quadratic": "drag",
    "press_5215": "drag",
    "bolt": "bolt",
    "hand": "hand",
    "squeeze": "squeeze",
}
"""Module of each scene."""


def build_scene(name: str, options: SceneOptions | None = None) -> BenchScene:
    """The scene of a name; InputError says which there are."""
    require_known("scene", name, SCENES)
    module = import_module(f"taccel_lab.benchmarks.scenes.{SCENES[name]}")
    options = options or SceneOptions()
    # Presses differ by their pad only.
    bench = module.build(options, name) if name.startswith("press") else module.build(options)
    if options.lag < 0:
        raise InputError(f"lag must not be negative, got {options.lag}")
    return replace(bench, lag=options.lag)


@dataclass(frozen=True)
class Scenes:
    """List the scenes: bodies, unknowns, steps, where their meshes are from."""

    def run(self) -> None:
        for name in SCENES:
            bench = build_scene(name)
            print(f"{name:<20} {bench.steps:>4} steps, {bench.source:<9}  {bench.what}")


__all__ = ["SCENES", "BenchScene", "SceneOptions", "Scenes", "build_scene"]
