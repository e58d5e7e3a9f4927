# SPDX-License-Identifier: Apache-2.0
"""The profile of a sensor that has been designed but not yet calibrated."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from taccel_lab.cad.mesh.gel_mesh import MESH_ARRAYS, kept_mesh, sound_gel_mesh
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, require_quality
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.guards import unknown
from taccel_lab.profile import (
    Block,
    BranchEntry,
    CameraBlock,
    CoatingBlock,
    GelBlock,
    HousingBlock,
    LayerMaterial,
    LightEntry,
    LightsBlock,
    MarkersBlock,
    MaterialBlock,
    OpticsBlock,
    Provenance,
    SensorBlock,
    SensorProfile,
    WindowBlock,
    load_profile,
    split_view,
)
from taccel_lab.profile.optical_design import OpticalDesign
from taccel_lab.sensors.base import FamilyParameters, SensorFamily
from taccel_lab.sensors.parameter_groups.camera import CameraParameters
from taccel_lab.sensors.registry import (
    catalogue_family,
    profile_folder,
    sensor_families,
    sensor_family,
)
from taccel_lab.sensors.starters import with_starter

_GRID = ("width_px", "height_px", "mm_per_px", "mm_per_px_y")
_METHOD = "defaults of the catalogue's family, with the overrides given"


def designed_profile(
    family: SensorFamily,
    parameters: FamilyParameters,
    mesh: TetMesh,
    quality: MeshQuality,
    *,
    mesher: str,
) -> SensorProfile:
    """Profile with all blocks that the family describes; each states what it rests on."""
    for seen in (parameters, *parameters.views().values()):
        _require_view(seen)
    origin = _Origin(family, parameters)
    pad, materials = parameters.pad(), parameters.layer_materials()
    gel = materials[0]
    profile = SensorProfile(
        sensor=SensorBlock(
            name=family.name,
            family=family.name,
            parameters=parameters.values(),
            provenance=Provenance(
                kind="designed",
                method="parameters of the catalogue's family, with the overrides given",
                source="; ".join(family.references) or family.title,
            ),
        ),
        gel=GelBlock(
            thickness_mm=pad.thickness_mm,
            node_count=mesh.node_count,
            tet_count=mesh.tet_count,
            min_dihedral_deg=quality.min_dihedral_deg,
            provenance=origin.of(
                "gel", kind="designed", method=f"{mesher} mesh of the parametric pad"
            ),
        ),
        material=MaterialBlock(
            young_modulus_pa=gel.young_modulus_pa,
            poisson_ratio=gel.poisson_ratio,
            density_kg_m3=gel.density_kg_m3,
            branches=tuple(
                BranchEntry(relative_modulus=modulus, time_s=time_s)
                for modulus, time_s in gel.branches
            ),
            friction_coefficient=gel.friction_coefficient,
            layers=tuple(
                LayerMaterial(
                    name=name,
                    young_modulus_pa=layer.young_modulus_pa,
                    poisson_ratio=layer.poisson_ratio,
                    density_kg_m3=layer.density_kg_m3,
                )
                for name, layer in zip(pad.layer_names[1:], materials[1:], strict=True)
            ),
            provenance=origin.of("material"),
        ),
        camera=_camera_block(parameters, origin),
        mesh=mesh,
        # All at once: each profile checks its blocks against one another.
        **{block.key: block for block in _optional_blocks(parameters, origin)},  # type: ignore[arg-type]
    )
    for name, seen in parameters.views().items():
        view = profile.with_block(profile.sensor.replace(parameters=seen.values()))
        view = view.with_block(_camera_block(seen, origin))
        optics = _optics_block(seen, seen.optics(), origin)
        profile = profile.with_view(name, view if optics is None else view.with_block(optics))
    return profile


def _require_view(parameters: FamilyParameters) -> None:
    """The middle of the image lies over the gel, as a profile has it; says so in parameters."""
    grid, bounds = parameters.grid(), parameters.pad().bounds_mm()
    for axis, places in (("x", grid.x_mm()), ("y", grid.y_mm())):
        middle = float(places[0] + places[-1]) / 2
        low, high = bounds[:, "xy".index(axis)].tolist()
        if isinstance(parameters, CameraParameters) and not low <= middle <= high:
            raise InputError(
                f"principal_{axis}_px, camera_{axis}_mm and camera_tilt_{axis}_deg put the image's "
                f"middle at {axis} = {middle:.4g} mm; the gel reaches from {low:.4g} to {high:.4g} "
                "mm"
            )


def _camera_block(parameters: FamilyParameters, origin: _Origin) -> CameraBlock:
    return CameraBlock.from_grid(parameters.grid(), origin.of("camera", names=_GRID))


def _optics_block(
    parameters: FamilyParameters, design: OpticalDesign | None, origin: _Origin
) -> OpticsBlock | None:
    if design is None:
        return None
    crop = {}
    if isinstance(parameters, CameraParameters):
        crop = {
            "raw_px": (parameters.raw_width_px, parameters.raw_height_px),
            "crop": (parameters.crop_x, parameters.crop_y),
        }
    return OpticsBlock.from_design(design, origin.of("camera", "window", "lights"), **crop)


def _optional_blocks(parameters: FamilyParameters, origin: _Origin) -> list[Block]:
    blocks: list[Block] = []
    design, markers, housing = parameters.optics(), parameters.markers(), parameters.housing()
    optics = _optics_block(parameters, design, origin)
    if design is not None and optics is not None:
        blocks.append(optics)
        leds = tuple(LightEntry(**asdict(light)) for light in design.lights)
        blocks.append(LightsBlock(led=leds, provenance=origin.of("lights")))
        blocks.append(CoatingBlock(**asdict(design.coating), provenance=origin.of("coating")))
        if design.window is not None:
            blocks.append(WindowBlock(**asdict(design.window), provenance=origin.of("window")))
    if markers is not None:
        blocks.append(MarkersBlock(**asdict(markers), provenance=origin.of("markers")))
    if housing is not None:
        blocks.append(HousingBlock(**asdict(housing), provenance=origin.of("housing")))
    return blocks


_UNPUBLISHED = re.compile(r"\bassumption\b|^set by the user$|^fit\b")


class _Origin:
    """Says where the parameters of a group come from."""

    def __init__(self, family: SensorFamily, parameters: FamilyParameters) -> None:
        self._family = family
        self._described = parameters.describe()

    def of(
        self,
        *groups: str,
        names: tuple[str, ...] = (),
        kind: Literal["designed", "assumed", "published"] | None = None,
        method: str = _METHOD,
    ) -> Provenance:
        """Sources of the groups' parameters, or of ``names`` among them; assumed when one of them
        is, or was fitted here to captures of other units: no publication has it then."""
        sources = {
            name: item["source"]
            for name, item in self._described.items()
            if (item["group"] or "gel") in groups and (not names or name in names)
        }
        unpublished = any(_UNPUBLISHED.search(text) for text in sources.values())
        return Provenance(
            kind=kind or ("assumed" if unpublished or not sources else "published"),
            method=method,
            source="; ".join(f"{name}: {text}" for name, text in sources.items())
            or self._family.title,
        )


def catalogue_profile(name: str, overrides: Mapping[str, Any] | None = None) -> SensorProfile:
    """Profile of a catalogue sensor with the structured mesh; parameters as they stand there.

    ``overrides`` replace some of the parameters.
    """
    family = sensor_family(name)
    parameters = family.parameters(overrides)
    mesh, quality = _sound_mesh(parameters.pad())
    return designed_profile(family, parameters, mesh, quality, mesher="structured")


@lru_cache(maxsize=64)
def _sound_mesh(pad: Pad) -> tuple[TetMesh, MeshQuality]:
    """Mesh and quality, made once a process for designs with the same gel; its arrays cannot be
    written."""
    mesh, quality, edge_mm = kept_mesh(pad, sound_gel_mesh)
    require_quality(mesh, quality, QualityGate().at_edge(edge_mm))
    for name in MESH_ARRAYS:
        getattr(mesh, name).flags.writeable = False
    return mesh, quality


def stock_sensor(name: str) -> SensorProfile:
    """Loads as ``load_sensor``, for who reads images: a catalogue sensor has the blocks of its
    starter where there is one (``sensors.starters``)."""
    profile = load_sensor(name)
    return profile if catalogue_family(name) is None else with_starter(profile)


def load_sensor(name: str) -> SensorProfile:
    """A profile, see ``profile_folder``, or the default design of a catalogue sensor; the view of
    one of its cameras is ``NAME@VIEW``."""
    sensor, view = split_view(name)
    if view is not None:
        return load_sensor(sensor).seen_by(view)
    if catalogue_family(name) is not None:
        return catalogue_profile(name)
    folder = profile_folder(name)
    if folder is not None or Path(name).exists():
        return load_profile(folder or name)
    raise InputError(
        f"{name!r} is neither a profile folder nor a sensor of the catalogue"
        f"{unknown(name, sensor_families(), 'taccel-lab sensors list')}"
    )
