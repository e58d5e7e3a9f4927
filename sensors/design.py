# SPDX-License-Identifier: Apache-2.0
"""Files of a family and its parameters: CAD, moulds, drawings, mesh, quality, profile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from taccel_lab.cad.mesh.gel_mesh import gel_mesh, sound_gel_mesh, usual_edge_mm
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, measure_quality, require_quality
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.geometry import TetMesh
from taccel_lab.guards import require_known
from taccel_lab.profile import SensorProfile, save_profile
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.base import FamilyParameters, SensorFamily, hardness_of
from taccel_lab.sensors.profile import designed_profile
from taccel_lab.sensors.workshop import WORKSHOP_PARTS, Workshop, issue_of, sensor_parts

MESHERS = ("structured", "tetwild")
DEFAULT_MESHER = "structured"
"""Mesher that is used unless another is named. Measured on the GelSight pad at 1 mm, structured
against fTetWild at its first try: smallest dihedral angle 19.9 and 8.6 deg, volume error -0.08 and
-0.14 %, Hausdorff 0.022 and 0.013 mm, meshing 0.4 and 21 s; back, window and contact nodes exact
and the same on every run against approximate and different."""
FirstLook = Callable[[FamilyParameters, Path], Path]
"""Draws parameters into a folder and returns the picture's path."""


@dataclass(frozen=True)
class DesignResult:
    """What ``design_sensor`` made."""

    family: SensorFamily
    parameters: FamilyParameters
    pad: Pad
    mesh: TetMesh
    quality: MeshQuality
    profile: SensorProfile
    mesher: str
    out_dir: Path
    files: dict[str, Path]
    """Written files by kind: mesh, quality, parameters, preview, profile, those of the workshop,
    and the sections where a first look was asked for."""
    seconds: dict[str, float]
    """Time of each stage [s]."""
    warnings: list[str]
    """What a maker should know, in words."""


def design_sensor(
    family: SensorFamily,
    overrides: Mapping[str, Any] | None = None,
    out_dir: Path | str = "design",
    mesher: str = DEFAULT_MESHER,
    edge_mm: float | None = None,
    *,
    parts: Sequence[str] = WORKSHOP_PARTS,
    first_look: FirstLook | None = None,
    progress: Progress = silent,
) -> DesignResult:
    """Build a sensor of ``family`` and write everything to ``out_dir``, whole or not at all.

    ``edge_mm`` is the target edge length of the mesh [mm], that of ``sound_gel_mesh`` (tetwild:
    ``usual_edge_mm``) when None, ``parts`` the files for the workshop (``WORKSHOP_PARTS``); mesh,
    quality, parameters, preview and profile are always written. ``first_look`` draws the design
    before anything is built, such as ``sensors.sensor_picture.write_sections``.
    ``progress`` is called when each stage begins and ends. A mesh that fails its gate raises
    InputError and leaves a picture of where in ``refused_folder(out_dir)``.
    """
    for kind in parts:
        require_known("part of a design", kind, WORKSHOP_PARTS)
    require_known("mesher", mesher, MESHERS)
    require_replaceable(out_dir)
    parameters = family.parameters(overrides)
    pad = parameters.pad()
    out_dir = Path(out_dir)
    seconds: dict[str, float] = {}
    tell = StageClock(seconds, progress)

    with atomic_directory(out_dir) as folder:
        drawn: dict[str, str] = {}
        if first_look is not None:
            tell("sections")
            drawn["sections"] = first_look(parameters, folder).name
        tell("cad")
        from taccel_lab.cad.export import dimensions
        from taccel_lab.cad.mesh.tessellate import tessellate_solid
        from taccel_lab.cad.parts.pad_solid import gel_layers, labelled_solid

        part = labelled_solid(pad)

        @cache
        def of_cad() -> dict[str, Any]:
            return {"cad_volume_mm3": part.volume_mm3, "cad_surface": tessellate_solid(part)}

        tell("mesh")
        quality = None
        if mesher == "tetwild":
            from taccel_lab.cad.mesh.tetrahedralize import tetwild_gel_mesh

            edge_mm = usual_edge_mm(pad) if edge_mm is None else edge_mm
            mesh = tetwild_gel_mesh(pad, edge_mm, part=part, picture_folder=refused_folder(out_dir))
        elif edge_mm is None:
            mesh, quality, edge_mm = sound_gel_mesh(pad, **of_cad())
        else:
            mesh = gel_mesh(pad, edge_mm)
        tell("quality")
        if quality is None:
            quality = measure_quality(mesh, pad, **of_cad())
        gate = QualityGate().at_edge(edge_mm)
        try:
            passed = require_quality(mesh, quality, gate, picture_folder=refused_folder(out_dir))
        except InputError as error:
            other = (
                "another edge_mm" if mesher == "tetwild" else "the mesher tetwild (takes longer)"
            )
            raise InputError(
                f"{error}. Try {other}, or dimensions nearer to the defaults"
            ) from error
        profile = designed_profile(family, parameters, mesh, quality, mesher=mesher)
        tell("assembly")
        assembly = None
        if "assembly" in parts:
            with _hint(parts, "assembly"):
                assembly = sensor_parts(family.name, parameters, part)
        layers = gel_layers(pad, part)
        issue = issue_of({"family": family.name, **parameters.values()})
        tell("files")
        workshop = Workshop(
            name=family.name,
            folder=folder,
            solid=part,
            surface=of_cad()["cad_surface"],
            layers=layers,
            assembly=assembly,
            table=_table(parameters),
            stiffness=stiffness_words(parameters),
            issue=issue,
        )
        workshop.files |= drawn
        for kind in WORKSHOP_PARTS:
            if kind in parts:
                tell(kind)
                with _hint(parts, kind):
                    workshop.write(kind)
        tell("files")
        workshop.write_mesh(mesh, mesher)
        save_profile(profile, workshop.path("profile", "profile"))
        tell(None)
        workshop.write_quality(quality, passed, mesher, edge_mm, seconds)
        write_json(
            workshop.path("parameters", "parameters.json"),
            {
                "sensor": family.name,
                "title": family.title,
                "revision": issue.revision,
                "parameters": parameters.describe(),
                "part": dimensions(part, pad),
                "warnings": workshop.warnings,
                "references": list(family.references),
            },
        )
    return DesignResult(
        family=family,
        parameters=parameters,
        pad=pad,
        mesh=mesh,
        quality=quality,
        profile=profile,
        mesher=mesher,
        out_dir=out_dir,
        files={kind: out_dir / name for kind, name in workshop.files.items()},
        seconds=seconds,
        warnings=workshop.warnings,
    )


def refused_folder(out_dir: Path | str) -> Path:
    """Where the picture of a refused mesh goes: beside the folder that was not written."""
    out_dir = Path(out_dir)
    return out_dir.with_name(f"{out_dir.name}_refused")


def stiffness_words(parameters: FamilyParameters) -> str:
    """What a workshop mixes for: the durometer's reading where one is stated, and the modulus of
    each layer."""
    known, values = parameters.parameters(), parameters.values()
    hardness = hardness_of(values)
    words = [known[hardness].worded(values[hardness])] if hardness else []
    moduli = [f"{m.young_modulus_pa / 1e6:.3g}" for m in parameters.layer_materials()]
    return ", ".join([*words, f"E {' and '.join(moduli)} MPa"])


def _table(parameters: FamilyParameters) -> dict[str, tuple[float | int | str, str]]:
    """Parameters that shape the gel for the table of a drawing: the family's, as --set takes them.

    Those of the gel's group, and those that the family has of its own.
    """
    return {
        name: (item["value"], item["unit"])
        for name, item in parameters.describe().items()
        if item["group"] in ("gel", "")
    }


@contextmanager
def _hint(parts: Sequence[str], kind: str) -> Iterator[None]:
    """Add to an error how to leave out what cannot be built."""
    try:
        yield
    except InputError as error:
        others = " ".join(["--parts", *(part for part in parts if part != kind)])
        raise InputError(f"{error} (or leave the {kind} out: {others})") from error


class StageClock:
    """Times the stages and tells which one begins and ends; None ends the last."""

    def __init__(self, seconds: dict[str, float], progress: Progress) -> None:
        self._seconds, self._progress = seconds, progress
        self._stage: str | None = None
        self._began = 0.0

    def __call__(self, stage: str | None) -> None:
        now = time.perf_counter()
        if self._stage is not None:
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + now - self._began
            self._progress(self._stage, 1, 1)
        self._stage, self._began = stage, now
        if stage is not None:
            self._progress(stage, 0, 1)
