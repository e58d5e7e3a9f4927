# SPDX-License-Identifier: Apache-2.0
"""The sensor of a profile as a family: what a study, a preview and a calibration vary and build.

Its parameters are those of the profile's family, with the profile's values as defaults. Of an
imported gel, which no family describes, camera, lights, coating, markers and material are those of
the family that it is like; the shape of the gel is that of the profile's mesh, whose glued surface
``thickness_mm`` moves.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeGuard

from taccel_lab.cad.mesh.mesh_pad import THICKNESSES_MM, MeshPad, SurfacePad
from taccel_lab.cad.parameters import Parameter
from taccel_lab.errors import InputError
from taccel_lab.sensors.base import (
    HARDNESSES,
    OF_A_HARDNESS,
    STIFFNESS,
    FamilyParameters,
    GelMaterial,
    SensorFamily,
    hardness_of,
)

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock, SensorBlock, SensorProfile

IMPORTED = "imported"
"""Family, in a profile, of a gel that no family describes: it is the profile's mesh."""
LIKE_KEY = "like"
"""Parameter of such a profile: the family that its sensor is like but for the gel."""
SHAPES = ("gel", "housing")
"""Groups of parameters of no use to an imported gel: the file says its shape, and there is no
housing."""
THICKNESS = "thickness_mm"
"""The one parameter of a shape that an imported gel with a mesh has."""
_MATERIAL = {
    "young_modulus_mpa": lambda block: 1e-6 * block.young_modulus_pa,
    "poisson_ratio": lambda block: block.poisson_ratio,
    "density_kg_m3": lambda block: block.density_kg_m3,
    "friction": lambda block: block.friction_coefficient,
}
"""Parameters that a material which was measured states."""
_MEASURED = ("calibrated", "measured")


@dataclass(frozen=True, kw_only=True)
class ProfileFamily(SensorFamily):
    """A family whose defaults are the values of a profile."""

    parameters_type: type[FamilyParameters] = field(init=False)
    like: SensorFamily
    """Family of the catalogue."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """Values other than those of ``like``."""
    gel: SurfacePad | None = None
    """The gel, where it is not the pad of ``like``."""

    def __post_init__(self) -> None:
        made = _parameters_type(self.like, self.defaults, self.gel)
        object.__setattr__(self, "parameters_type", made)

    @property
    def label(self) -> str:
        return self.title.partition(":")[0]

    @property
    def identity(self) -> str:
        """Stands for what the parameters do not say."""
        return self.like.name if self.gel is None else f"{self.like.name} {self.gel.digest}"

    def parameters(self, overrides: Mapping[str, Any] | None = None) -> FamilyParameters:
        """Parameters as of any family; an imported gel refuses those of a shape."""
        given = dict(overrides or {})
        known = dict(self.defaults)
        if _has_thickness(self.gel, self.like):
            known[THICKNESS] = self.gel.thickness_mm
        if self.gel is not None:
            require_no_shape(self.like, [name for name in given if name not in known])
        if any(given.get(name) for name in STIFFNESS):
            known = {name: value for name, value in known.items() if name not in STIFFNESS}
        return super().parameters({**known, **given})

    def __getstate__(self) -> dict[str, Any]:
        # The type of the parameters is made here and found in no module.
        return {name: value for name, value in vars(self).items() if name != "parameters_type"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()


def profile_family(profile: SensorProfile, name: str, like: SensorFamily) -> ProfileFamily:
    """The sensor of ``profile``, which is called ``name``; ``like``: see ``like_name``."""
    imported = profile.sensor.family == IMPORTED
    known = like.parameters_type.parameters()
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in profile.sensor.parameters.items()
        if key in known
    }
    if profile.material.provenance.kind in _MEASURED:
        values |= _measured(profile.material, known)
    # A profile of a hardness says the Poisson's ratio that it was made with, whatever that is.
    kept = OF_A_HARDNESS if hardness_of(values) else ()
    defaults = {k: value for k, value in values.items() if value != known[k].default or k in kept}
    pad = MeshPad(profile.gel.thickness_mm, mesh=profile.mesh) if imported else None
    what = f"its own gel, all else like {like.name}" if imported else like.title
    return ProfileFamily(
        name=name,
        title=f"{profile.sensor.name}: {what}",
        references=like.references,
        like=like,
        defaults=defaults,
        gel=pad,
    )


def like_name(sensor: SensorBlock) -> str:
    """The family of the catalogue whose parameters a profile with this block has.

    Raises:
        InputError: An imported gel of a version that did not keep it.
    """
    if sensor.family != IMPORTED:
        return sensor.family
    like = sensor.parameters.get(LIKE_KEY)
    if not isinstance(like, str):
        raise InputError(
            f"the profile of {sensor.name} does not say which sensor it is like: it was "
            "made by an earlier version; run taccel-lab import-gel again"
        )
    return like


def imported_gel(like: SensorFamily, gel: SurfacePad) -> ProfileFamily:
    """A sensor that is ``like`` one of the catalogue but for its gel."""
    title = f"its own gel, all else like {like.name}"
    return ProfileFamily(name=IMPORTED, title=title, like=like, gel=gel)


def require_no_shape(like: SensorFamily, names: Iterable[str]) -> None:
    """InputError for parameters of ``like`` that say a shape."""
    specs = like.parameters_type.parameters()
    useless = [name for name in names if name in specs and _group(specs[name]) in SHAPES]
    if useless:
        allowed = sorted({_group(spec) for spec in specs.values()} - {*SHAPES})
        raise InputError(
            f"{', '.join(useless)} cannot be set: the file gives the gel's shape; parameters of "
            f"{', '.join(allowed)} can be set"
        )


def _parameters_type(
    like: SensorFamily, defaults: Mapping[str, Any], gel: SurfacePad | None
) -> type[FamilyParameters]:
    """The parameters of ``like`` with other defaults, and on another gel where one is given."""

    class Stated(like.parameters_type):  # type: ignore[name-defined,misc]
        @classmethod
        def parameters(cls) -> dict[str, Parameter]:
            return {
                name: dataclasses.replace(spec, default=defaults[name], source="the profile's")
                if name in defaults
                else spec
                for name, spec in super().parameters().items()
                if gel is None or _group(spec) not in SHAPES
            }

    if gel is None:
        return Stated

    class OnGel(Stated):
        def pad(self) -> SurfacePad:
            return self._built_pad

        @cached_property
        def _built_pad(self) -> SurfacePad:
            return gel

        def gel_depth_mm(self) -> float:
            return self.pad().thickness_mm

        def layer_materials(self) -> tuple[GelMaterial, ...]:
            # One material: a file of a shape does not say where a skin would be.
            return (self.material(),)

        def housing(self) -> None:
            return None

    if not _has_thickness(gel, like):
        return OnGel
    mesh_pad, spec = gel, like.parameters_type.parameters()[THICKNESS]
    low, high = THICKNESSES_MM
    thickness = dataclasses.replace(
        spec, default=gel.thickness_mm, minimum=low, maximum=high, zero_means="", source="the mesh",
        description="gel under the apex: the glued surface moves along the normal, contact face "
        "and outline stay",
    )  # fmt: skip

    class OnThickness(OnGel):
        @classmethod
        def parameters(cls) -> dict[str, Parameter]:
            return {THICKNESS: thickness, **super().parameters()}

        @cached_property
        def _built_pad(self) -> SurfacePad:
            return mesh_pad.of_thickness(getattr(self, THICKNESS))

    return OnThickness


def _has_thickness(gel: SurfacePad | None, like: SensorFamily) -> TypeGuard[MeshPad]:
    """Whether a gel has another thickness for the asking: one with a mesh, like a sensor with such
    a parameter."""
    return isinstance(gel, MeshPad) and THICKNESS in like.parameters_type.parameters()


def _measured(block: MaterialBlock, known: Mapping[str, Parameter]) -> dict[str, Any]:
    found = {name: read(block) for name, read in _MATERIAL.items() if name in known}
    if len(block.branches) > 1:
        raise InputError(
            f"material.branches of the profile has {len(block.branches)} branches; the parameters "
            "of a sensor state one"
        )
    for branch in block.branches:
        found |= {"maxwell_modulus": branch.relative_modulus, "maxwell_time_s": branch.time_s}
    return found | {name: 0.0 for name in HARDNESSES if name in known}


def _group(spec: Parameter) -> str:
    return spec.group or "gel"
