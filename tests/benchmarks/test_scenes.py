# SPDX-License-Identifier: Apache-2.0
"""The benchmark scenes: meshes of the stated size, motions that converge and intersect nothing."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.benchmarks.scenes.squeeze import surface_value, teddy_mesh, without_pinches
from taccel_lab.bodies.crossings import crossing_pairs
from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.bodies.mesh_checks import check_surface, check_tets
from taccel_lab.bodies.primitives import unique_edges
from taccel_lab.errors import InputError
from taccel_lab.exporters.published_meshes import choose_source, has_data, mesh_folder, read_stl
from taccel_lab.model.embedding import rotate
from taccel_lab.tasks.parts import PITCH_M, hexagon_nut, threaded_rod
from tests.support.intersection import find_intersections

STEPS = {"peg": 6, "press_239": 6, "squeeze": 3, "hand": 2, "bolt": 2}


def converges(name: str, source: str, steps: int | None) -> None:
    bench = build_scene(name, SceneOptions(source=source))
    assert bench.source == source
    runner = Runner(bench)
    motion = runner.run(steps)
    assert len(motion.seconds) == (bench.steps if steps is None else steps)
    residual = motion.residual()
    assert residual["unconverged"] == 0, residual["causes"]
    assert residual["worst_over_allowed"] <= 1
    assert motion.of("contact_force_n").max() > 0
    assert find_intersections(runner.model, runner.state) == [[]]


@pytest.mark.thorough(cases=("bolt-2", "hand-2", "squeeze-3"))
@pytest.mark.parametrize(("name", "steps"), STEPS.items())
def test_scenes_begin(name: str, steps: int) -> None:
    converges(name, "generated", steps)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["generated", "published"])
@pytest.mark.parametrize("name", SCENES)
def test_whole_motions(name: str, source: str) -> None:
    if name.startswith("press_2005") and source == "published":
        pytest.skip("its mesh is always ours")
    if source == "published" and not has_data("pads"):
        pytest.skip(f"the published meshes are not at {mesh_folder()}")
    converges(name, source, None)


def test_environments_may_lag() -> None:
    bench = build_scene("press_239", SceneOptions(4, "generated", lag=2))
    np.testing.assert_array_equal(bench.targets(5), bench.path[[5, 4, 3, 5]])
    np.testing.assert_array_equal(bench.targets(1), bench.path[[1, 0, 0, 1]])
    motion = Runner(bench).run(8, keep_forces=True)
    sinking = -motion.forces_n[-1][:, 0, 2]
    assert motion.residual()["unconverged"] == 0 and sinking[0] > sinking[1] > sinking[2] > 0


def test_rod_and_nut_are_closed_and_fit() -> None:
    rod, nut = threaded_rod(), hexagon_nut()
    for mesh in (rod, nut):
        check_surface(mesh.vertices_m, mesh.faces, "thread", closed=True)
        assert mass_properties(mesh, 1.0).volume_m3 > 1e-5
    assert len(rod.faces) == pytest.approx(7980, rel=0.05)
    assert len(nut.faces) == pytest.approx(3064, rel=0.1)
    from scipy.spatial import KDTree

    # A pitch up is the same place; half a pitch up the threads would cross.
    aligned = nut.vertices_m + [0, 0, 4 * PITCH_M]
    gap = KDTree(rod.vertices_m).query(aligned)[0].min()
    assert gap > 0.3e-3


@pytest.mark.thorough
def test_the_hands_gels_keep_apart() -> None:
    bench = build_scene("hand", SceneOptions(source="generated"))
    assert len(bench.scene.soft_bodies) == 17
    assert sum(b.mesh.node_count for b in bench.scene.soft_bodies) == pytest.approx(3252, rel=0.01)
    placed = []
    for body, pose in zip(bench.scene.soft_bodies, bench.path[-1], strict=True):
        nodes, faces = rotate(pose[3:], body.mesh.nodes_m) + pose[:3], body.mesh.faces
        placed.append((nodes[unique_edges(faces)], nodes[faces]))
    for (edges, _), (_, faces) in permutations(placed, 2):
        assert not len(crossing_pairs(edges, faces)[0])


def test_the_bear() -> None:
    mesh = teddy_mesh()
    check_tets(mesh, "bear")
    used, faces = np.unique(mesh.faces, return_inverse=True)
    check_surface(mesh.nodes_m[used], faces.reshape(-1, 3), "bear", closed=True)
    assert 400 < mesh.node_count < 1600
    # Its outside follows the formula to a part of a cell.
    on_surface = surface_value(mesh.nodes_m[used] + [0, 0, mesh.nodes_m[:, 2].min()])
    assert np.abs(on_surface).mean() < 5e-4


@pytest.mark.parametrize("other", [(1, 1, 0), (1, 1, 1)])
def test_pinches_are_filled(other: tuple[int, int, int]) -> None:
    inside = np.zeros((4, 4, 4), dtype=bool)
    for cell in ((0, 0, 0), other):
        inside[tuple(np.array(cell) + 1)] = True
    filled = without_pinches(inside)
    assert filled[inside].all() and filled.sum() > inside.sum()
    assert (without_pinches(filled) == filled).all()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"solid", r"part\.stl is no binary STL"),
        (
            bytes(80) + b"\1\0\0\0" + np.full(12, np.nan, "<f4").tobytes() + b"\0\0",
            r"part\.stl: a triangle mesh ",
        ),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "part.stl").write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_stl(tmp_path / "part.stl")


def test_what_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TACCEL_LAB_DATA", str(tmp_path))
    assert choose_source("auto", "pads/sensor.vtk") == "generated"
    for build, message in (
        (lambda: choose_source("published", "pads/sensor.vtk"), r"TACCEL_LAB_DATA.*generated"),
        (lambda: build_scene("peg", SceneOptions(source="nonsense")), "source must be"),
        (lambda: build_scene("nonsense"), "no scene"),
        (lambda: build_scene("peg", SceneOptions(lag=-1)), "lag"),
    ):
        with pytest.raises(InputError, match=message):
            build()
