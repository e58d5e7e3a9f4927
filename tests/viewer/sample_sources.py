# SPDX-License-Identifier: Apache-2.0
"""Sources that were made by nobody: sound ones, and the same with an attack for every name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from taccel_lab.geometry.block import block_mesh
from taccel_lab.profile import save_profile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.viewer.press_folder import PRESS, STATES
from tests.support.small_data_sets import make, saved_profile

ABOUT = {"sensor": "x", "friction_coefficient": 0.5, "press": {"force_n": 1.5}}
REPLAYED = {
    "task": "x", "seed": 3, "cause": "", "bodies": [{"name": "b", "kind": "soft"}], "forces": ["f"],
}  # fmt: skip


def press_arrays() -> dict[str, np.ndarray]:
    """What ``press --states`` keeps, of a block and a triangle that comes down in two steps."""
    mesh = block_mesh((2, 2, 1), (0.02, 0.02, 0.004))
    nodes, steps = len(mesh.nodes_m), 3
    return {
        "nodes_m": mesh.nodes_m,
        "tets": mesh.tets.astype(np.int64),
        "faces": mesh.faces.astype(np.int64),
        "depth_mm": np.array([0.0, 0.1, 0.2]),
        "force_n": np.zeros((steps, 3)),
        "indenter_poses": np.tile([0.0, 0, 0.001, 0, 0, 0, 1], (steps, 1)),
        "moved_m": np.zeros((steps, nodes, 3)),
        "contact_forces_n": np.zeros((steps, nodes, 3)),
        "contact_pressures_pa": np.zeros((steps, nodes)),
        "von_mises_pa": np.zeros((steps, nodes)),
        "indenter_vertices_m": 1e-3 * np.eye(3),
        "indenter_faces": np.array([[0, 1, 2]]),
        "images": np.zeros((steps, 4, 6, 3), dtype=np.uint8),
    }


def write_press(folder: Path, arrays: dict[str, np.ndarray], about: object) -> None:
    np.savez(folder / STATES, **arrays)
    (folder / PRESS).write_text(json.dumps(about))


def sound_replay() -> dict[str, np.ndarray]:
    """What ``task record`` keeps, of four frames of two triangles."""
    return {
        "times_s": np.arange(4.0),
        "depth_m": np.zeros((4, 5, 6)),
        "pressure_pa": np.zeros((4, 5, 6)),
        "markers_px": np.zeros((4, 2, 2)),
        "rgb": np.zeros((4, 5, 6, 3), dtype=np.uint8),
        "forces_n": np.zeros((4, 1)),
        "vertices_m_0": np.random.default_rng(1).random((4, 4, 3)),
        "faces_0": np.array([[0, 1, 2], [0, 2, 3]]),
    }


ATTACK = (
    "<img src='//0.0.0.0:1/a' onerror='hacked=1' class='f'><b onclick='hacked=2' class='f'>x</b>"
    "[x](javascript:hacked=3)|![x](http://0.0.0.0:1/b'<iframe srcdoc='<script>top.hacked=4"
    "</script>'>www.a/'<b"
)
"""At most 200 characters, as names of profiles."""


def hostile_profile(folder: Path) -> None:
    profile = catalogue_profile("flat_pad")
    named = profile.sensor.model_copy(update={"name": ATTACK, "family": ATTACK})
    save_profile(profile.with_block(named), folder)


def hostile_press(folder: Path) -> None:
    write_press(folder, press_arrays(), {**ABOUT, "sensor": ATTACK, "indenter": ATTACK})


def hostile_replay(folder: Path) -> None:
    np.savez(folder / "replay.npz", **sound_replay())
    about = {**REPLAYED, "task": ATTACK, "forces": [ATTACK]}
    (folder / "replay.json").write_text(json.dumps(about))


def hostile_study(folder: Path) -> None:
    StudyFolder(folder).add_row(
        DesignRow(id="one", family="flat_pad", parameters={}, status="done", figures={ATTACK: 1.0})
    )


def hostile_dataset(folder: Path) -> None:
    profile = saved_profile(folder.with_name("profile"))
    make(profile, folder, dataset={"episodes": 2}, output={"channels": ["depth_mm"]})
    about = json.loads((folder / "dataset.json").read_text())
    (folder / "dataset.json").write_text(json.dumps({**about, "name": ATTACK}))
