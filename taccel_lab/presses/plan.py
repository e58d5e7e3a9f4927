# SPDX-License-Identifier: Apache-2.0
"""A press as it is planned: checked before a kernel is compiled or a mesh is made."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.contact_sweep import ContactSweep
from taccel_lab.geometry.length_units import size_words
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.model.launches import require_device
from taccel_lab.presses import parse_indenter, physics_difference
from taccel_lab.presses.mesh import is_beside_edge, refined_press_mesh
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.photo import PhotoReader, PressPhoto
from taccel_lab.presses.sweep import path_contact
from taccel_lab.presses.touch import check_depth, element_m
from taccel_lab.processes.process_pool import Call, at_once
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.profile.assumed import is_modulus_known
from taccel_lab.profile.measured_range import measured_range
from taccel_lab.report.style import save_drawing
from taccel_lab.scene import TriangleMesh
from taccel_lab.sensors.any_sensor import AnySensor, profile_of, reading_profile_of
from taccel_lab.sensors.registry import profile_parameters, profile_sensor
from taccel_lab.signals.color_model import ColorModel

if TYPE_CHECKING:
    from taccel_lab.cad.parts.pad import Pad
    from taccel_lab.presses import Indenter, PressPath, PressPhysics
    from taccel_lab.presses.outcome import SeenFrom
    from taccel_lab.profile import SensorProfile


RESOLVED = 4
"""Elements along the width of a tool's relief that a press of it needs."""


@dataclass(frozen=True)
class PressPlan:
    """A press of one sensor, checked: what is pressed into what, on which meshes, and seen how."""

    sensor: str
    """Name of what is pressed, as it was given."""
    profile: SensorProfile
    indenter: Indenter
    options: PressOptions
    physics: PressPhysics
    friction: float
    """Coefficient between indenter and gel."""
    photo: PressPhoto | None = None
    """What is to be pressed like."""
    is_rough: bool = False
    """Whether it only leads to another press: its error is not measured."""

    @classmethod
    def plan(
        cls, sensor: AnySensor, options: PressOptions, photo_reader: PhotoReader | None = None
    ) -> Self:
        """Refuse, before a mesh is made, all that can be rejected. Errors as of ``press``.

        ``photo_reader`` is needed with ``like``."""
        start_warp()
        require_device(options.device)
        options.require_aim()
        indenter = parse_indenter(options.indenter, options.read_texture())
        physics, profile = (
            options.physics(),
            reading_profile_of(sensor) if options.like else profile_of(sensor),
        )
        stated = profile.material.friction_coefficient
        friction = stated if options.friction is None else options.friction
        name = str(sensor) if isinstance(sensor, (str, Path)) else profile.sensor.name
        photo = None
        if options.like is not None:
            assert photo_reader is not None
            photo = PressPhoto.read(profile, options.like, options.untouched, photo_reader)
            options = replace(options, depth_mm=photo.depth_mm, at_mm=photo.at_mm)
        run = cls(name, profile, indenter, options, physics, friction, photo)
        options.path(run.first_mm)
        if (options.hold_s or options.speed_mm_s is not None) and not profile.material.branches:
            raise InputError(
                f"the gel of {name} does not relax, so that time changes nothing: leave out "
                "--hold-s and --speed-mm-s, or give its material branches"
            )
        check_depth(run.first_mm, profile)
        indenter.require_size(run.first_mm)
        ColorModel.from_profile(profile)
        return run

    @property
    def first_mm(self) -> float:
        """Depth of the first press [mm]: the one asked for, or where the search begins."""
        if self.options.depth_mm is not None:
            return self.options.depth_mm
        from taccel_lab.presses.force_search import FIRST_SHARE

        return FIRST_SHARE * self.profile.gel.thickness_mm

    @property
    def remembers(self) -> bool:
        """Whether the gel's state depends on the path that led there."""
        return self.friction > 0 or bool(self.profile.material.branches)

    @property
    def is_friction_doubtful(self) -> bool:
        """Whether friction that nobody measured matters beside what is known of the modulus."""
        material = self.profile.material
        measured = measured_range(self.profile, "friction_coefficient") is not None
        chosen = self.options.friction is not None or measured or self.friction == 0
        return is_modulus_known(material) and not chosen

    @property
    def differs(self) -> str | None:
        """How the press differs from those that the material was fitted with, in a sentence."""
        return physics_difference(self.profile.material, self.physics, self.friction)

    def notes(self) -> list[str]:
        """What a person should know before the press, a sentence each."""
        found = list(self.profile.sensor.provenance.remarks[:1])
        if self.differs is not None:
            found.append(self.differs)
        if self.photo is not None:
            found += self.photo.warnings
        found += self.indenter.remarks
        if self.indenter.name.startswith("mesh:") and isinstance(self.indenter.shape, TriangleMesh):
            words = size_words(self.indenter.shape.vertices_m)
            found.append(f"{self.options.indenter} is {words}")
        found += self._unresolved()
        aside = any((*self.options.shear_mm, self.options.twist_deg))
        if aside and self.friction == 0 and isinstance(self.indenter.shape, TriangleMesh):
            # A punch that has 1 mm to go takes 9.8 % too much; after a way it is right.
            found.append(
                "the mesh's rows of nodes stand where the way aside ends: the errors are those of "
                "its last step, and forces of steps before it may be a tenth too large"
            )
        return found

    def _unresolved(self) -> list[str]:
        """Say which relief of the tool is finer than the elements that meet it."""
        contact, texture = self.indenter.contact(self.first_mm), self.indenter.texture
        widths = {
            "tool": contact.relief_mm if isinstance(contact, ToolSection) else math.inf,
            "texture": math.inf if texture is None else 1e3 * texture.relief_width_m,
        }
        if min(widths.values()) == math.inf:
            return []
        faces, at_m = self.gel.region_faces(Region.CONTACT), 1e-3 * np.array(self.options.at_mm)
        element_mm = 1e3 * element_m(self.gel.nodes_m, faces, at_m)
        then = {
            "tool": "force and heights may be those of a smoother tool",
            "texture": "images show it, but the force is that of its mean surface",
        }
        return [
            f"the {name}'s relief is about {width_mm:.2g} mm wide, finer than the gel's elements "
            f"resolve: they are {element_mm:.2g} mm long there and {RESOLVED} are needed along a "
            f"width; {then[name]}"
            for name, width_mm in widths.items()
            if width_mm < RESOLVED * element_mm
        ]

    @cached_property
    def gel(self) -> TetMesh:
        """Mesh of the first press, in the gel frame [m]."""
        path = self.options.path(self.first_mm)
        return self._meshed(self.near(self.physics, path, self.friction), path)

    def near(self, physics: PressPhysics, path: PressPath, friction: float) -> PressPhysics:
        """Physics of a press along a path; a contact range that was asked for stays."""
        near = physics.of_press(path.depth_mm, friction, self.profile.material.poisson_ratio)
        return near if self.options.dhat_mm is None else replace(near, dhat_m=physics.dhat_m)

    def write_scene(self, folder: Path, call: Call = at_once) -> Path:
        """Draw what is about to be pressed, which compiles nothing; returns the picture, which is
        there when ``call`` is done."""
        from taccel_lab.presses.scene_picture import SCENE, draw_scene

        path, gel, family = folder / SCENE, self.gel, profile_sensor(self.profile)
        at_mm, aim = self.options.at_mm, self.options.aim()
        seen = family, gel, self.indenter, at_mm, self.first_mm, aim
        call(save_drawing, path, draw_scene, *seen)
        return path

    @cached_property
    def _views(self) -> dict[str, SeenFrom]:
        """All cameras by name, the main one first, and the pad's face at rest on their pixels."""
        from taccel_lab.presses.outcome import SeenFrom
        from taccel_lab.signals.rest_surface import rest_surface

        found = {}
        for name in self.profile.view_names():
            camera = camera_of(self.profile.seen_by(name))
            found[name] = SeenFrom(camera, rest_surface(self.profile.mesh, face_of(camera)))
        return found

    def mesh_for(self, physics: PressPhysics, path: PressPath, refinement: float = 1.0) -> TetMesh:
        """Mesh of a press along a path, in the gel frame [m], with ``refinement`` times as many
        elements along every side as ``physics`` says."""
        first = self.options.path(self.first_mm)
        usual = self.near(self.physics, first, self.friction).mesh
        if (path, refinement, physics.mesh) == (first, 1.0, usual):
            return self.gel
        return self._meshed(physics, path, refinement)

    def _meshed(self, physics: PressPhysics, path: PressPath, refinement: float = 1.0) -> TetMesh:
        if self.options.mesh == "profile":
            return self.profile.mesh
        try:
            contact, sweep = self._contact(path)
            at_mm, mesh, pad = self.options.at_mm, physics.mesh, self._pad
            return refined_press_mesh(pad, at_mm, contact, mesh, refinement, sweep)
        except InputError as error:
            x, y = self.options.at_mm
            raise InputError(
                f"{self.sensor} cannot be meshed for a press at ({x:g}, {y:g}) mm: {error}"
            ) from error

    @cached_property
    def _pad(self) -> Pad:
        return profile_parameters(self.profile).pad()

    def _contact(self, path: PressPath) -> tuple[float | ToolSection, ContactSweep]:
        gel, material = self.profile.gel, self.profile.material
        return path_contact(
            self.indenter, path, self.friction, gel.thickness_mm, material.poisson_ratio
        )

    def is_beside_edge(self, path: PressPath) -> bool:
        """Say whether a ball comes so near to the pad's edge that its mesh is no usual one."""
        if self.options.mesh == "profile":
            return False
        return is_beside_edge(self._pad, self.options.at_mm, *self._contact(path))
