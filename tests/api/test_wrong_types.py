# SPDX-License-Identifier: Apache-2.0
"""Arguments of another type end in a sentence that names them, whatever the public name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from tests.fuzz.samples.shapes import stl

BOX = tl.box_mesh((0.002, 0.002, 0.002))
CORNERS = np.concatenate([np.zeros((1, 3)), np.eye(3)])
TET = tl.TetMesh(CORNERS, np.array([[0, 1, 2, 3]]), np.array([[0, 2, 1]]), np.zeros(1, int))
SOUND: dict[str, dict[str, Any]] = {
    "AffineBody": {"shape": BOX, "density_kg_m3": 1e3, "name": "o", "initial_pose": None},
    "Ball": {"radius_m": 0.004},
    "FixedJoint": {"first": "a", "second": "b", "anchor_m": (0.0, 0.0, 0.0), "bodies_touch": False},
    "KinematicBody": {"shape": BOX, "friction_coefficient": 0.5, "surface": tl.Surface()},
    "MarkerLayout": {"nodes": np.zeros((1, 3), int), "weights": np.ones((1, 3)), "lifts_m": None},
    "Material": {"young_modulus_pa": 1e5, "poisson_ratio": 0.4, "model": "neo_hookean",
                 "branches": ()},
    "MaterialField": {"young_modulus_pa": 1e5, "poisson_ratio": 0.4},
    "Outputs": {"solver": None},
    "PixelGrid": {"width_px": 32, "height_px": 24, "mm_per_px_x": 0.1, "mm_per_px_y": 0.1},
    "Plane": {"point_m": (0.0, 0.0, 0.0), "normal": (0.0, 0.0, 1.0), "friction_coefficient": None},
    "PositionDrive": {"stiffness": 1.0, "target": 0.0, "max_effort": 1.0},
    "PressOptions": {"depth_mm": 0.3, "indenter": "sphere:4", "at_mm": (0.0, 0.0), "like": None},
    "PressPath": {"depth_mm": 0.3, "shear_mm": (0.0, 0.0), "back": False},
    "PrismaticJoint": {"first": "a", "second": "b", "limits_mm": (-1.0, 1.0), "drive": None},
    "Reader": {"sensor": "none", "background": None, "mask": None, "method": "auto",
               "device": "cpu"},
    "RevoluteJoint": {"first": "a", "second": "b", "axis": (0.0, 0.0, 1.0)},
    "Scene": {"soft_bodies": (), "env_count": 1, "time": None, "pair_friction": None},
    "SoftBody": {"mesh": TET, "material": tl.Material(1e5, 0.4), "bonded_nodes": None},
    "SolverConfig": {"dhat_m": 2e-5, "max_newton_iterations": 9},
    "SolverIPC": {"model": None, "config": None},
    "Surface": {"layer": 1, "thickness_m": 0.0, "environments": None, "apart_from": frozenset()},
    "TetMesh": {"nodes_m": CORNERS, "tets": TET.tets, "faces": TET.faces,
                "face_regions": TET.face_regions},
    "TimeStepping": {"quasi_static": True, "dt_s": 0.02, "scheme": "euler"},
    "TriangleMesh": {"vertices_m": BOX.vertices_m, "faces": BOX.faces},
    "VelocityDrive": {"damping": 1.0, "target": 0.0},
    "box_mesh": {"size_m": (1e-3, 1e-3, 1e-3)},
    "calibrate": {"folder": "none", "base": None, "only": "color", "options": None},
    "cylinder_mesh": {"radius_m": 1e-3, "height_m": 1e-3, "segments": 16},
    "initial_state": {"model": None, "poses": None},
    "open_dataset": {"folders": "none", "split": None},
    "parse_indenter": {"text": "sphere:4", "texture": None},
    "press": {"sensor": "none", "indenter": "sphere:4", "progress": None},
    "profile_material": {"block": None, "mesh": TET},
    "profile_scene": {"profile": None, "mesh": None, "gel": None},
    "read": {"sensor": "none", "image": "none.png", "background": None, "mask": None,
             "method": "auto"},
    "save_profile": {"profile": None, "path": "p", "only": None},
    "sphere_mesh": {"radius_m": 1e-3, "edge_m": 5e-4},
    "study": {"file": "none.toml", "out": None, "processes": None, "limit": None},
    "to_torch": {"array": None},
    "validate_profile": {"path": "none"},
}  # fmt: skip
"""Sound arguments by public name, or such that the call ends at once, without a sensor."""
WRONG = (
    None, True, Path("x"), "abc", "", "1", -1, 0, 1.5, float("nan"), float("inf"), 10**400, [],
    [1, 2], ["a"], [None], {}, {"a": 1}, {1: 2}, b"x", object(), np.zeros((2, 2)), np.zeros(0),
    np.full(3, np.nan), np.array(["a", "b"]), 1j, {1}, (1.0, "a", None), int, [[1], [1, 2]],
)  # fmt: skip


@pytest.mark.parametrize("name", SOUND)
def test_an_argument_of_another_type_ends_in_a_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, wrong = getattr(tl, name), 0
    for place in SOUND[name]:
        for value in WRONG:
            arguments = SOUND[name] | {place: value}
            if name == "SoftBody" and not isinstance(arguments["mesh"], tl.TetMesh):
                arguments["bonded_nodes"] = None
            try:
                call(**arguments)
            except (tl.InputError, OSError) as error:
                assert " object at 0x" not in str(error)
                wrong += 1
    assert wrong


@pytest.mark.parametrize(("call", "said"), [
    (lambda: tl.read(None, "a.png"), r"read: sensor must be .*SensorProfile .* a text, got None"),  # type: ignore[arg-type]
    (lambda: tl.read("digit", "a.png", method="depths"), "method must be 'auto' or .*'depths'"),  # type: ignore[arg-type]
    (lambda: tl.press("digit", True), "indenter must be a text or a path, got True"),  # type: ignore[arg-type]
    (lambda: tl.press("digit", depth_mm="0.3"), "depth_mm must be a number or None, got '0.3'"),
    (lambda: tl.press("digit", depth_mm=True), "depth_mm must be a number or None, got True"),
    (lambda: tl.press("digit", depth_mm=10**400), "depth_mm must be a number .* of 1329 bits"),
    (lambda: tl.press("digit", depth_mm=0.3, at_mm=(1,)), r"at_mm must be 2 numbers, got \[1\]"),
    (lambda: tl.Material("soft", 0.4), "young_modulus_pa must be a number, got 'soft'"),  # type: ignore[arg-type]
    (lambda: tl.Plane(point_m=(0, "x", 0)), r"point_m must be 3 numbers, got \[0, 'x', 0\]"),  # type: ignore[arg-type]
    (lambda: tl.TriangleMesh({}, np.zeros((1, 3))), "vertices_m must be an array of numbers"),  # type: ignore[arg-type]
    (lambda: tl.Scene(affine_bodies=BOX), "AffineBody or a list, each of it .*AffineBody, got a"),  # type: ignore[arg-type]
    (lambda: tl.load_sensor(None), r"load_sensor: sensor must be .*a text, got None"),  # type: ignore[arg-type]
    (lambda: tl.study(None), "study: file must be a path or a text, got None"),  # type: ignore[arg-type]
])  # fmt: skip
def test_what_is_allowed_is_said(call: Callable[[], Any], said: str) -> None:
    with pytest.raises(tl.InputError, match=said):
        call()


def test_numbers_of_numpy_are_numbers_and_lists_are_arrays() -> None:
    grid = tl.PixelGrid(np.int64(4), 3, np.float32(0.1), 1)  # type: ignore[arg-type]
    assert (grid.width_px, grid.mm_per_px_y) == (4, 1)
    assert len(tl.TriangleMesh(BOX.vertices_m.tolist(), BOX.faces.tolist()).faces) == len(BOX.faces)  # type: ignore[arg-type]


def test_a_path_is_the_mesh_of_an_indenter(tmp_path: Path) -> None:
    stl(tmp_path)
    path = tmp_path / "words.stl"
    assert tl.parse_indenter(path).name == tl.parse_indenter(f"mesh:{path}").name == f"mesh:{path}"
    assert tl.PressOptions.of(indenter=path, depth_mm=0.3).indenter == f"mesh:{path}"
