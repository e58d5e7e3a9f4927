# SPDX-License-Identifier: Apache-2.0
"""FEATS (Helmut et al.; MIT): force_indentation.json, measured force-indentation points."""

import re
from pathlib import Path

from taccel_lab.calibration.capture.importers import Draft, ImportOptions
from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_json
from taccel_lab.files.table_file import number


def read(source: Path, options: ImportOptions) -> list[Draft]:
    """The record and its ball, which stands in prose."""
    path = source if source.is_file() else source / "force_indentation.json"
    values = read_json(path)
    said = re.search(r"radius (\S+) mm", str(values.get("indenter"))[:500])
    try:
        radius_mm = options.radius_mm or number(said[1] if said else "")
        depths, forces = values["indentation_mm"], values["normal_force_N"]
        pairs = [(float(d), float(f)) for d, f in zip(depths, forces, strict=True)]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: {error}") from error
    draft = Draft("", "gelsight_mini", path.parent)
    draft.assume_sensor("that of the published set (feats-ai/feats)")
    draft.used.add(path)
    rows = "".join(f"{depth_mm!r},{force_n!r}\n" for depth_mm, force_n in pairs)
    name = draft.add_text(f"depth_mm,force_n\n{rows}", f"{path.stem}.csv")
    tool = {"kind": "sphere", "radius_mm": radius_mm}
    draft.manifest["records"] = [{"file": name, "kind": "indentation", "tool": tool}]
    return [draft]
