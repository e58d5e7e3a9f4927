# SPDX-License-Identifier: Apache-2.0
"""A press before its way: the gel on its mesh, the tool, and the physics between them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

from taccel_lab.geometry import TetMesh
from taccel_lab.presses.indenter import Indenter
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.presses.resolution import AS_IT_IS, Resolution
from taccel_lab.presses.sweep import path_contact
from taccel_lab.scene import Material, MaterialField

if TYPE_CHECKING:
    from taccel_lab.presses.mesh import Pad
    from taccel_lab.presses.path import PressPath

MaterialOf = Callable[[TetMesh], Material | MaterialField]
"""Material of a gel on one of its meshes."""


@dataclass(frozen=True)
class PressSetup:
    """A gel, a tool, and the physics of one pressed into the other."""

    mesh: TetMesh
    """Gel pad in the gel frame."""
    material: Material | MaterialField
    """Material of the gel, uniform or by tet."""
    indenter: Indenter
    """Rigid body that is pressed."""
    friction_coefficient: float = 0.0
    """Coefficient between indenter and gel."""
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT]
    """Element, contact range and tolerance. Its ``mesh`` says how ``mesh`` was made, and decides
    nothing more."""
    device: str = "cpu"
    """Warp device."""

    @cached_property
    def batch_key(self) -> str:
        """Equal for presses that can be environments of one scene, but for material and friction:
        tool, physics and all of the mesh but its places."""
        told = json.dumps([self.indenter.name, self.physics.record()])
        digest = hashlib.sha256(told.encode())
        for array in (
            self.mesh.tets, self.mesh.faces, self.mesh.face_regions, self.mesh.tet_layers
        ):  # fmt: skip
            digest.update(array.tobytes())
        return digest.hexdigest()

    @classmethod
    def on_pad(
        cls,
        pad: Pad,
        material_of: MaterialOf,
        indenter: Indenter,
        at_mm: tuple[float, float],
        path: PressPath,
        *,
        poisson_ratio: float,
        friction_coefficient: float = 0.0,
        physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
        resolution: Resolution = AS_IT_IS,
        device: str = "cpu",
        in_batch: bool = False,
    ) -> Self:
        """Return the press of a pad along a path, meshed as by ``press``.

        Args:
            pad: Shape of the gel.
            material_of: Gives the material on a mesh.
            indenter: Tool.
            at_mm: Gel xy of its axis.
            path: Way of the tool.
            poisson_ratio: Of the gel's face.
            friction_coefficient: Between indenter and gel.
            physics: A grade, which ``PressPhysics.of_press`` makes that of the press.
            resolution: How much finer mesh and contact range are.
            device: Warp device.
            in_batch: Whether others are to share its contact range, see there.

        Raises:
            InputError: A place where the pad cannot be meshed.
        """
        # Loads CAD, which a run on meshes that are there does without.
        from taccel_lab.presses.mesh import refined_press_mesh

        physics = physics.of_press(
            path.depth_mm, friction_coefficient, poisson_ratio, in_batch=in_batch
        )
        contact, sweep = path_contact(
            indenter, path, friction_coefficient, pad.thickness_mm, poisson_ratio
        )
        mesh = refined_press_mesh(pad, at_mm, contact, physics.mesh, resolution.mesh, sweep)
        physics = resolution.physics(physics, indenter.shape, path)
        return cls(mesh, material_of(mesh), indenter, friction_coefficient, physics, device)
