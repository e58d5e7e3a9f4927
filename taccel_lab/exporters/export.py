# SPDX-License-Identifier: Apache-2.0
"""A profile to a folder of another project's files, whole or not at all, with ``export.json``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.exporters import (
    gs_sdk,
    isaac_lab,
    network_files,
    opencv_yaml,
    taccel,
    tacto,
    taxim_folder,
    urdf,
)
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.guards import require_known
from taccel_lab.profile import SensorProfile
from taccel_lab.version import __version__

RECORD_FILE = "export.json"


@dataclass(frozen=True)
class Exporter:
    """What writes a format, and what it was written for."""

    write: Callable[[SensorProfile, Path], ExportRecord]
    peer: str
    what: str
    """What the format is, in a sentence."""


EXPORTERS = {
    "taccel": Exporter(
        taccel.export_taccel,
        "Taccel-Simulator/Taccel, commit 52bf1f5",
        "Taccel's fabrication list: JSON, tets as VTK, masks and markers, STL.",
    ),
    "tacto": Exporter(
        tacto.export_tacto,
        "tacto 0.0.3",
        "TACTO's sensor configuration: YAML with camera, gel and lights, STL.",
    ),
    "taxim": Exporter(
        taxim_folder.export_taxim,
        "taxim 1.4.1 (PyPI), TacEx's GPU-Taxim",
        "Calibration folder of the PyPI package taxim and of TacEx: colour table, background.",
    ),
    "isaac-lab": Exporter(
        isaac_lab.export_isaac_lab,
        "Isaac Lab, isaaclab_contrib.sensors.tacsl_sensor",
        "Isaac Lab's GelSight data folder (TacSL) with its configuration.",
    ),
    "gs-sdk": Exporter(
        gs_sdk.export_gs_sdk,
        "gs_sdk 0.2 (joehjhuang/gs_sdk)",
        "gs_sdk's device file, background and network from colour to gradients.",
    ),
    "onnx": Exporter(
        network_files.export_onnx,
        f"ONNX opset {network_files.OPSET} (onnxruntime 1.15 and later)",
        "The networks of colour, normals and force as ONNX graphs.",
    ),
    "safetensors": Exporter(
        network_files.export_safetensors,
        "safetensors 0.4 and later",
        "The same networks as safetensors, with settings and formula.",
    ),
    "opencv": Exporter(
        opencv_yaml.export_opencv,
        "OpenCV 4 and 5, cv2.FileStorage",
        "Camera matrix, distortion and pose as OpenCV's YAML.",
    ),
    "urdf": Exporter(
        urdf.export_urdf,
        "URDF 1.0 (ROS, PyBullet, Isaac Sim, yourdfpy)",
        "A URDF with meshes, inertias and the frames of gel and camera.",
    ),
}


def export_profile(
    profile: SensorProfile, to: str, out: Path | str, *, table: Path | str | None = None
) -> dict[str, Any]:
    """Write ``profile`` in the format ``to`` as the folder ``out``; returns ``export.json``.

    ``table`` is the file of a table fitted to captures, which ``taxim`` then gets instead of one
    distilled from the colour model.

    Raises InputError when the format is unknown, when the profile lacks a block that it cannot do
    without, or when ``out`` holds files of somebody else.
    """
    require_known("format", to, EXPORTERS)
    if table is not None and to != "taxim":
        raise InputError(f"a table fitted to captures goes to the format taxim only, not to {to}")
    require_replaceable(out)
    exporter = EXPORTERS[to]
    write = exporter.write
    if table is not None:
        write = partial(taxim_folder.export_taxim, table=Path(table))
    with atomic_directory(out) as folder:
        record = write(profile, folder)
        if profile.views and "views" not in record.carries:
            names = ", ".join(f"FOLDER@{name}" for name in profile.views)
            record.left_out["views"] = f"these are files of one camera; export {names} besides"
        files = sorted(
            str(path.relative_to(folder))
            for path in folder.rglob("*")
            if path.is_file() and path.name != OUTPUT_MARKER
        )
        document = {
            "format": to,
            "description": exporter.what,
            "peer": exporter.peer,
            "tool_version": __version__,
            "sensor": profile.sensor.name,
            "files": files,
            "carries": dict(sorted(record.carries.items())),
            "left_out": dict(sorted(record.left_out.items())),
            "approximations": record.approximations,
            "notes": record.notes,
            "provenance": {
                key: {"kind": block.provenance.kind, "verdict": block.provenance.verdict}
                for key, block in profile.blocks().items()
            },
        }
        write_json(folder / RECORD_FILE, document)
    return document
