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
    onnx_models,
    opencv_yaml,
    taccel,
    tacto,
    taxim_folder,
    urdf,
)
from taccel_lab.exporters.formats import FORMATS
from taccel_lab.exporters.record import ExportRecord
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.output_folder import atomic_directory, require_replaceable
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.profile import SensorProfile
from taccel_lab.version import __version__

RECORD_FILE = "export.json"


@dataclass(frozen=True)
class Exporter:
    """What writes a format, and what it was written for."""

    write: Callable[[SensorProfile, Path], ExportRecord]
    peer: str


EXPORTERS = {
    "taccel": Exporter(taccel.export_taccel, taccel.PEER),
    "tacto": Exporter(tacto.export_tacto, tacto.PEER),
    "taxim": Exporter(taxim_folder.export_taxim, taxim_folder.PEER),
    "isaac-lab": Exporter(isaac_lab.export_isaac_lab, isaac_lab.PEER),
    "gs-sdk": Exporter(gs_sdk.export_gs_sdk, gs_sdk.PEER),
    "onnx": Exporter(onnx_models.export_onnx, onnx_models.PEER),
    "safetensors": Exporter(network_files.export_safetensors, network_files.PEER),
    "opencv": Exporter(opencv_yaml.export_opencv, opencv_yaml.PEER),
    "urdf": Exporter(urdf.export_urdf, urdf.PEER),
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
    if to not in EXPORTERS:
        raise InputError(f"no format {to!r}; known: {', '.join(FORMATS)}")
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
            "description": FORMATS[to],
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
