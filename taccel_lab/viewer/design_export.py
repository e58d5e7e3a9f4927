# SPDX-License-Identifier: Apache-2.0
"""What a design page writes: one folder a kind of file, and the parameters as TOML."""

from __future__ import annotations

import io
import shlex
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taccel_lab.cad.parameters import value_text
from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.sensors.base import SensorFamily

DESIGN_TOML = "design.toml"
EXPORTS = {
    "STEP, STL, 3MF, DXF": ("pad", ("pad",)),
    "drawing": ("drawing", ("drawing",)),
    "profile and mesh": ("profile", ()),
    "everything": ("everything", ("pad", "assembly", "mould", "drawing")),
}
"""Folder and parts for the workshop of each button."""
TOML = "parameters (TOML)"


def export(
    kind: str, family: SensorFamily, overrides: Mapping[str, Any], out: Path
) -> dict[str, Path]:
    """Write a kind of ``EXPORTS`` or ``TOML`` into a folder below ``out``, whole or not at all; an
    earlier one of the page is replaced.

    Returns files by kind. Raises InputError for a design that cannot be built, or for a folder with
    files of somebody else.
    """
    if kind == TOML:
        import tomli_w

        with atomic_directory(out / "parameters") as folder:
            text = tomli_w.dumps({"sensor": family.name, "parameters": dict(overrides)})
            (folder / DESIGN_TOML).write_text(text, encoding="utf-8")
        return {"parameters": out / "parameters" / DESIGN_TOML}
    from taccel_lab.sensors.design import design_sensor

    name, parts = EXPORTS[kind]
    return design_sensor(family, overrides, out / name, parts=parts).files


def packed(files: list[Path], out: Path) -> tuple[str, bytes]:
    """Name and content of what a browser downloads: the file, or a ZIP file of several."""
    if len(files) == 1:
        return files[0].name, files[0].read_bytes()
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in files:
            # Without its own time, which a clock that is not set puts before what ZIP can say.
            entry = zipfile.ZipInfo(path.relative_to(out).as_posix())
            archive.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)
    return f"{files[0].relative_to(out).parts[0]}.zip", memory.getvalue()


def read_design(path: Path) -> tuple[str, dict[str, Any]]:
    """Sensor and parameters of a file that ``export`` wrote; InputError for another one."""
    table = read_toml(path)
    sensor, parameters = table.get("sensor"), table.get("parameters", {})
    if not isinstance(sensor, str) or not isinstance(parameters, dict) or set(table) - {
        "sensor", "parameters",
    }:  # fmt: skip
        raise InputError(
            f'{path} is no design: it needs sensor = "NAME" and a table [parameters], nothing else'
        )
    return sensor, parameters


def command_line(family: SensorFamily, overrides: Mapping[str, Any], out: Path) -> str:
    """What does the same without the page."""
    words = ["taccel-lab", "design", family.name, "--out", str(out / "everything")]
    if overrides:
        values = (f"{name}={value_text(value)}" for name, value in overrides.items())
        words += ["--set", *values]
    return shlex.join(words)
