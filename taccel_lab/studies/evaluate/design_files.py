# SPDX-License-Identifier: Apache-2.0
"""Files of a design besides its figures: mesh, STEP, pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import content_id
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.metrics.design_point import DesignFigures
from taccel_lab.studies.spec.study_file import StudyOutput

if TYPE_CHECKING:
    from taccel_lab.cad.parts.pad import Pad

MESHES, STEPS, PICTURE = "meshes", "steps", "picture.png"
"""Designs with the same pad share one mesh and one STEP file, named by a hash of the pad."""


def write_design_files(
    folder: StudyFolder, result: DesignFigures, output: StudyOutput, name: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Write what ``output`` asks for; ``name`` is what the picture calls the design.

    Returns:
        Files by kind, relative to the study's folder, and causes why some could not be written.
    """
    from taccel_lab.sensors.registry import sensor_family

    family = result.point.family
    sensor = sensor_family(family)
    parameters = sensor.parameters(result.point.parameters)
    pad = parameters.pad()
    files: dict[str, str] = {}
    causes: dict[str, str] = {}
    if output.meshes:
        files["mesh"] = f"{MESHES}/{content_id(repr(pad))}.vtu"
    if output.step:
        files["step"] = f"{STEPS}/{content_id(repr(pad))}.step"
    for kind, write in (("mesh", _write_mesh), ("step", _write_step)):
        path = folder.root / files.get(kind, ".")
        if kind not in files or path.is_file():
            continue
        path.parent.mkdir(exist_ok=True)
        try:
            write(pad, path, sensor.label)
        except InputError as error:
            causes[f"file {kind}"] = str(error)
            del files[kind]
    if output.pictures:
        from taccel_lab.studies.evaluate.pictures import write_picture

        file = f"designs/{result.point.id}/{PICTURE}"
        title = f"{sensor.label}, {name}"
        if write_picture(parameters, result.records, folder.root / file, title) is not None:
            files["picture"] = file
    return files, causes


def _write_mesh(pad: Pad, path: Path, family: str) -> None:
    """The gel at the default resolution; presses have their own, finer meshes."""
    from taccel_lab.cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.geometry.vtu import write_mesh_vtu

    write_mesh_vtu(path, gel_mesh(pad))


def _write_step(pad: Pad, path: Path, family: str) -> None:
    from taccel_lab.cad.export import write_step
    from taccel_lab.cad.parts.pad_solid import labelled_solid

    write_step(labelled_solid(pad), path, name=f"{family}_gel_pad")
