# SPDX-License-Identifier: Apache-2.0
"""Files kept of a design besides its figures: mesh, STEP, pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from studies.design_point import DesignResult
from studies.spec import Output
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from sensors.base import FamilyParameters

MESH, STEP, PICTURE = "mesh.vtu", "pad.step", "picture.png"


def keep_files(
    folder: Path, result: DesignResult, output: Output
) -> tuple[dict[str, str], dict[str, str]]:
    """Write what ``output`` asks for into the design's folder.

    Returns:
        Written files by kind, relative to the folder, and causes why some could not be.
    """
    from sensors.registry import sensor_family

    parameters = sensor_family(result.point.family).parameters(result.point.parameters)
    files: dict[str, str] = {}
    causes: dict[str, str] = {}
    if output.meshes:
        try:
            _write_mesh(parameters, folder / MESH)
            files["mesh"] = MESH
        except InputError as error:
            causes["file mesh"] = str(error)
    if output.step:
        try:
            _write_step(parameters, folder / STEP, result.point.family)
            files["step"] = STEP
        except InputError as error:
            causes["file step"] = str(error)
    if output.pictures:
        from studies.pictures import write_picture

        title = f"{result.point.family}, design {result.point.id}"
        if write_picture(parameters, result.records, folder / PICTURE, title) is not None:
            files["picture"] = PICTURE
    return files, causes


def _write_mesh(parameters: FamilyParameters, path: Path) -> None:
    """The gel at the default resolution; presses have finer meshes of their own."""
    from cad.mesh.gel_mesh import gel_mesh
    from taccel_lab.geometry.vtu import write_mesh_vtu

    write_mesh_vtu(path, gel_mesh(parameters.pad()))


def _write_step(parameters: FamilyParameters, path: Path, family: str) -> None:
    from cad.export import write_step
    from taccel_lab.output import atomic_file

    with atomic_file(path) as staging:
        write_step(parameters.pad().labelled_solid(), staging, name=f"{family}_gel_pad")
        staging.chmod(0o644)
