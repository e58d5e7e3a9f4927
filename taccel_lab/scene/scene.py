# SPDX-License-Identifier: Apache-2.0
"""``Scene``: what a user says about a simulation, and the way from there to a device."""

from __future__ import annotations

import os

from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model import Model, build_model
from taccel_lab.model.turns import in_turn
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.scene.checks import check_scene


class Scene(SceneDescription):
    """Bodies and how they meet, in ``env_count`` copies; ``finalize`` makes a model of it."""

    @in_turn
    def finalize(self, device: str | None = None) -> Model:
        """Build the device arrays; raises InputError for meshes that cannot be used.

        ``device``: "cpu" or "cuda:0", "cuda:1", ...; when None what the environment variable
        TACCEL_LAB_DEVICE says, else the CPU.
        """
        start_warp()
        check_scene(self)
        return build_model(self, device or os.environ.get("TACCEL_LAB_DEVICE", "cpu"))
