# SPDX-License-Identifier: Apache-2.0
"""Speed on a machine that has numpy and Warp alone, with meshes as they are published."""

from __future__ import annotations

import os
import subprocess
import venv
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.results import read_result
from taccel_lab.benchmarks.scenes.base import pad
from taccel_lab.exporters.mesh_files import tet_grid, write_vtk
from taccel_lab.geometry import Region

ROOT = Path(__file__).parents[2]
PUBLISHED = "single_sensor__pad_maxv_1e-07"
CODE = """
import sys
from pathlib import Path
from taccel_lab.benchmarks import learning
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.benchmarks.speed import Speed
from taccel_lab.benchmarks.stress import suite
from taccel_lab.errors import InputError
for name in SCENES:
    # The meshes of these are made of a sensor of the catalogue, by its CAD.
    try:
        assert build_scene(name, SceneOptions(source="generated")).steps > 10
    except InputError as error:
        assert name.startswith("press_2005") and "meshed by scipy: install it" in str(error)
options = {"scene": ("press_239",), "source": "published", "steps": 2, "repeats": 1}
Speed(**options, check=True, startup=False, out=Path(sys.argv[1])).run()
assert not [name for name in sys.modules if name.startswith("taccel_lab.cad")]
"""


@pytest.fixture
def bare_python(tmp_path: Path) -> Path:
    """The interpreter of an environment that has numpy and Warp alone."""
    made = tmp_path / "environment"
    venv.create(made, symlinks=True)
    (packages,) = made.glob("lib/python*/site-packages")
    for package in (np, wp):
        folder = Path(package.__path__[0])
        (packages / folder.name).symlink_to(folder)
        if (libraries := folder.with_name(f"{folder.name}.libs")).is_dir():
            (packages / libraries.name).symlink_to(libraries)
    return made / "bin" / "python"


@pytest.mark.thorough
def test_numpy_and_warp_are_all_that_speed_needs(bare_python: Path, tmp_path: Path) -> None:
    mesh, _ = pad(239, "generated")
    pads = tmp_path / "data" / "taccel_assets" / "pads"
    pads.mkdir(parents=True)
    # The file's contact face looks to -z.
    write_vtk(pads / f"{PUBLISHED}.vtk", tet_grid(mesh.nodes_m * [1, -1, -1], mesh.tets))
    held, touched = np.zeros((2, mesh.node_count), dtype=bool)
    held[mesh.region_nodes(Region.BOND)] = touched[mesh.region_nodes(Region.CONTACT)] = True
    np.savez(pads / f"{PUBLISHED}.npz", stick_mask=held, coat_mask=touched)
    where = {"PYTHONPATH": str(ROOT), "TACCEL_LAB_DATA": str(tmp_path / "data")}
    done = subprocess.run(
        [bare_python, "-c", CODE, tmp_path],
        env=os.environ | where,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "a page of it needs jinja2" in done.stderr
    document = read_result(tmp_path / "speed.json")
    (row,) = document["rows"]
    assert row["source"] == "published" and row["soft_nodes"] == mesh.node_count
    assert row["residual"]["unconverged"] == row["intersections"] == 0
    assert set(document["run"]["packages"]) == {"numpy", "warp-lang"}
