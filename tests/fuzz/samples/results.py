# SPDX-License-Identifier: Apache-2.0
"""What the program has written itself: tables, studies, kept results, marked outputs."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from taccel_lab.exporters.taxim_table import TABLE_FILE, TERMS, TableFile, TaximTable, write_table
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.files.file_cache import CACHE_VARIABLE, CachedFile, cached_arrays
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.vtu import write_mesh_vtu
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.runner import default_kit
from taccel_lab.studies.evaluate.study_folder import RESULT, STUDY_MARKER
from taccel_lab.studies.spec.study import make_study
from taccel_lab.studies.spec.study_file import load_spec
from taccel_lab.tasks.catalogue import FILES
from tools.bench.report.pages import FOLDER

STUDY = (
    '[study]\nname = "Thickness"\nsensor = "flat_pad"\n'
    'metrics = ["sensitivity_um", "force_range"]\npresses = ["sphere"]\nseed = 3\nload_n = 0.5\n'
    "\n[parameters.thickness_mm]\nmin = 2.5\nmax = 6.0\ncount = 3\n\n"
    "[parameters.young_modulus_mpa]\nvalues = [0.1, 0.2]\n\n"
    '[sweep]\nkind = "grid"\n\n'
    '[objective]\nmaximize = "sensitivity_um"\n\n'
    '[[constraints]]\nmetric = "force_range"\nmin = 5.0\n\n'
    "[output]\npictures = false\n\n"
    '[run]\ndevice = "cpu"\n\n'
    "[press.sphere]\ndepth_fraction = 0.3\n"
)


def table(given: Path) -> None:
    """A Taxim table of three bins."""
    grad = np.linspace(-1, 1, 3 * 3 * 3 * TERMS).reshape(3, 3, 3, TERMS)
    write_table(TableFile(TaximTable(3, grad), (320, 240), {"l1": 2.5}), given / TABLE_FILE)


def study_file(given: Path) -> None:
    (given / "study.toml").write_text(STUDY)


def study(given: Path) -> None:
    """A study of which every design has a row."""
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


def press(given: Path) -> None:
    """A press of two states on a box of five tets, and its end alone."""
    corners = 1e-3 * np.array([[x, y, z] for z in (0, 2) for y in (0, 3) for x in (0, 4)], float)
    tets = np.array([[0, 1, 2, 4], [1, 3, 2, 7], [1, 4, 5, 7], [2, 6, 4, 7], [1, 2, 4, 7]])
    faces = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 7], [4, 7, 6]])
    mesh = TetMesh(corners, tets, faces, np.zeros(4, dtype=np.int64))
    zeros, vectors = np.zeros((2, 8)), np.zeros((2, 8, 3))
    arrays = {
        "nodes_m": corners, "tets": tets, "faces": faces, "depth_mm": np.array([0.0, 0.1]),
        "force_n": np.zeros((2, 3)), "indenter_poses": np.zeros((2, 7)), "moved_m": vectors,
        "contact_forces_n": vectors, "contact_pressures_pa": zeros, "von_mises_pa": zeros,
        "indenter_vertices_m": corners, "indenter_faces": faces,
        "images": np.zeros((2, 6, 8, 3), np.uint8), "markers_px": np.zeros((2, 3, 2)),
        "image_px": np.array([8, 6]),
    }  # fmt: skip
    about = {
        "sensor": "box", "indenter": "sphere:2", "friction_coefficient": 0.3,
        "press": {"force_n": 1.0, "force_error_n": 0.1, "contact_radius_mm": 1.0},
    }  # fmt: skip
    fields = {"displacement_m": vectors[0], "contact_force_n": vectors[0], "von_mises_pa": zeros[0]}
    for name in ("steps", "end"):
        folder = given / name
        folder.mkdir()
        (folder / "press.json").write_text(json.dumps(about))
        if name == "steps":
            np.savez_compressed(folder / "states.npz", **arrays)
        else:
            write_mesh_vtu(folder / "gel.vtu", mesh, point_data=fields)


def training(given: Path) -> None:
    """A training that was interrupted."""
    state = {
        "key": "a",
        "step": 3,
        "seconds": 1.5,
        "weights": {"w": torch.zeros(4, 4)},
        "curve": [],
    }
    torch.save(state, given / "training.pt")


def bench(given: Path) -> None:
    """Two results of a suite of benchmarks."""
    for name in ("first.json", "second.json"):
        (given / name).write_bytes((FOLDER / "speed_lag_h200.json").read_bytes())


def task(given: Path) -> None:
    """A task of the package."""
    (given / "task.toml").write_bytes((FILES / "peg-insertion.toml").read_bytes())
