# SPDX-License-Identifier: Apache-2.0
"""``Scene``: what a user says about a simulation, and the way from there to a device."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from taccel_lab.bodies.scene_description import SceneDescription
from taccel_lab.model import Model, build_model
from taccel_lab.model.turns import in_turn
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.scene.checks import check_scene
from taccel_lab.scene.profile_gel import profile_gel

if TYPE_CHECKING:
    from taccel_lab.geometry import TetMesh
    from taccel_lab.profile import SensorProfile


class Scene(SceneDescription):
    """Bodies and how they meet, in ``env_count`` copies; ``finalize`` makes a model of it."""

    @classmethod
    def from_profile(
        cls,
        profile: SensorProfile,
        *,
        mesh: TetMesh | None = None,
        gel: Mapping[str, Any] | None = None,
        **scene: Any,
    ) -> Scene:
        """Make a scene whose soft body is the gel of a profile.

        ``SignalTactile.from_profile(profile, solver=...)`` then shows what that sensor sees.

        Args:
            profile: Sensor: mesh, material, friction.
            mesh: Of the same gel, coarser for many environments (``taccel_lab.cad.mesh.gel_mesh``,
                or a profile of ``taccel-lab design --edge-mm 2``); the profile's own when None.
            gel: Further fields of its ``SoftBody``, such as ``mount`` and ``element``.
            scene: Arguments of ``Scene``: ``kinematic_bodies``, ``env_count``, ...

        Raises:
            InputError: What ``SoftBody`` and ``Scene`` refuse.
        """
        return cls(profile_gel(profile, mesh, **(gel or {})), **scene)

    @in_turn
    def finalize(self, device: str | None = None) -> Model:
        """Build the device arrays; raises InputError for meshes that cannot be used.

        ``device``: "cpu" or "cuda:0", "cuda:1", ...; when None what the environment variable
        TACCEL_LAB_DEVICE says, else the CPU.
        """
        start_warp()
        check_scene(self)
        return build_model(self, device or os.environ.get("TACCEL_LAB_DEVICE", "cpu"))
