# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab bench scenes``: what scenes there are."""

from __future__ import annotations

from dataclasses import dataclass

from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene


@dataclass(frozen=True)
class Scenes:
    """List the scenes: bodies, unknowns, steps, where their meshes are from."""

    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""

    def run(self) -> None:
        for name in SCENES:
            bench = build_scene(name, SceneOptions(source=self.source))
            print(f"{name:<20} {bench.steps:>4} steps, {bench.source:<9}  {bench.what}")
