# SPDX-License-Identifier: Apache-2.0
"""What the program has written itself: tables, studies, kept results, marked outputs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from taccel_lab.exporters.taxim_table import TERMS, TaximTable
from taccel_lab.exporters.taxim_table_file import TABLE_FILE, TableFile, write_table
from taccel_lab.files.file_cache import CACHE_VARIABLE, CachedFile, cached_arrays
from taccel_lab.files.output_folder import atomic_directory

STUDY = """\
[study]
name = "Thickness"
sensor = "flat_pad"
metrics = ["sensitivity_um", "force_range"]
presses = ["sphere"]
seed = 3
load_n = 0.5

[parameters.thickness_mm]
min = 2.5
max = 6.0
count = 3

[parameters.young_modulus_mpa]
values = [0.1, 0.2]

[sweep]
kind = "grid"

[objective]
maximize = "sensitivity_um"

[[constraints]]
metric = "force_range"
min = 5.0

[output]
pictures = false

[run]
device = "cpu"

[press.sphere]
depth_fraction = 0.3
"""


def table(given: Path) -> None:
    """A Taxim table of three bins."""
    grad = np.linspace(-1, 1, 3 * 3 * 3 * TERMS).reshape(3, 3, 3, TERMS)
    write_table(TableFile(TaximTable(3, grad), (320, 240), {"l1": 2.5}), given / TABLE_FILE)


def curve(given: Path) -> None:
    """A measured curve of a ball, with a title and its way back."""
    depth = np.concatenate([np.linspace(0, 0.5, 12), np.linspace(0.4, 0, 5)])
    rows = [f"{d:.4f},{2.0 * d**1.5:.5f},{2.4 * d**0.5:.3f}" for d in depth]
    text = "\n".join(["depth_mm,force_n,contact_diameter_mm", *rows])
    (given / "gel.csv").write_text(text + "\n")


def study_file(given: Path) -> None:
    (given / "study.toml").write_text(STUDY)


def study(given: Path) -> None:
    """A study of which every design has a row."""
    from dataclasses import asdict

    from taccel_lab.files.atomic_file import to_jsonable
    from taccel_lab.studies.design_row import DesignRow
    from taccel_lab.studies.spec import load_spec
    from taccel_lab.studies.study import default_kit, make_study
    from taccel_lab.studies.study_folder import RESULT, STUDY_MARKER

    study_file(given)
    planned = make_study(load_spec(given / "study.toml"), default_kit())
    root = given / "study"
    (root / "designs").mkdir(parents=True)
    (root / STUDY_MARKER).write_text("1\n")
    for number, point in enumerate(planned.points()):
        row = DesignRow(
            id=point.id,
            family=point.family,
            parameters=to_jsonable(point.parameters),
            status="done",
            figures=dict.fromkeys(planned.metrics, 1.0 + number),
            seconds=1.0,
            simulations=1,
            curves={},
            figure_keys=dict(planned.figure_keys),
            press_keys=dict(planned.press_keys),
            tool_version="0",
            finished="2025-01-01T00:00:00+00:00",
        )
        folder = root / "designs" / point.id
        folder.mkdir()
        (folder / RESULT).write_text(json.dumps(to_jsonable(asdict(row))))


def kept_file() -> CachedFile[dict[str, np.ndarray]]:
    return cached_arrays("fuzz", {"recipe": 1})


def kept(given: Path) -> None:
    """A result in the cache, which is the folder itself."""
    os.environ[CACHE_VARIABLE] = str(given)
    kept_file().write({"a": np.arange(4.0)})


def output(given: Path) -> None:
    """An earlier output, which a command may replace."""
    with atomic_directory(given / "earlier") as folder:
        (folder / "press.json").write_text("{}")
        (folder / "more").mkdir()
        (folder / "more" / "a.csv").write_text("1,2\n")
