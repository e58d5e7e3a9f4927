# SPDX-License-Identifier: Apache-2.0
"""Touches of data sets, presses of studies and recorded tasks become what pages show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.viewer.study_presses import read_design_press


def test_presses_of_studies_start_untouched(tmp_path: Path) -> None:
    rest = np.array([[0.0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0]])
    moved = np.zeros((2, 3, 3))
    moved[1, 0, 2] = -1e-4
    arrays = {
        "depth_mm": np.array([0.1, 0.2]),
        "force_n": np.array([[0, 0, 0.5], [0, 0, 1.5]]),
        "contact_rest_m": rest,
        "contact_moved_m": moved,
        "contact_faces": np.array([[0, 1, 2]]),
    }
    np.savez(tmp_path / "press_sphere.npz", **arrays)
    states = read_design_press(tmp_path / "press_sphere.npz")
    assert states.count == 3 and "force 1.500 N" in states.captions[2]
    np.testing.assert_allclose(states.positions_mm(2, 2.0)[0], [0, 0, -0.2])
    arrays["contact_moved_m"] = moved[:0]
    np.savez(tmp_path / "none.npz", **arrays)
    with pytest.raises(InputError, match="no step"):
        read_design_press(tmp_path / "none.npz")


@pytest.mark.slow
def test_a_recorded_task_is_read_as_it_was(tmp_path: Path) -> None:
    from taccel_lab.tasks.catalogue import named
    from taccel_lab.tasks.film import film_seed
    from taccel_lab.tasks.replay import read_replay, write_replay
    from taccel_lab.tasks.scene_picture import surfaces

    film, _ = film_seed(named("ball-rolling"), 0, "cpu")
    write_replay(film, tmp_path)
    replay = read_replay(tmp_path)
    assert replay.task == "ball-rolling"
    np.testing.assert_array_equal(replay.times_s, film.times_s)
    last = surfaces(film.episode.scene, film.episode.model, film.positions_m[-1])
    for body, (kind, vertices, faces) in zip(replay.bodies, last, strict=True):
        assert body.kind == kind.name.lower()
        np.testing.assert_allclose(body.vertices_m[-1], vertices, atol=1e-8)
        np.testing.assert_array_equal(body.faces, faces)
    for name, value in film.forces_n[-1].items():
        assert replay.forces_n[name][-1] == value
    (tmp_path / "replay.json").write_text('{"task": "x", "bodies": [{}], "forces": []}')
    with pytest.raises(InputError, match="no replay"):
        read_replay(tmp_path)


@pytest.mark.slow
def test_touches_have_the_forces_and_depths_of_their_data_set(tmp_path: Path) -> None:
    pytest.importorskip("zarr")
    from taccel_lab.datasets.reading import Dataset
    from taccel_lab.viewer.dataset_touches import read_touch
    from tests.support.small_data_sets import make, saved_profile

    channels = ["rgb", "depth_mm", "patch_forces_n", "markers_px"]
    profile = saved_profile(tmp_path / "profile")
    make(profile, tmp_path / "data", dataset={"episodes": 2}, output={"channels": channels})
    data = Dataset(tmp_path / "data")
    place = next(k for k, row in enumerate(data.episodes) if row["rows"] > 1)
    states, rows = read_touch(data, place), data.rows_of(place)
    assert states.count == len(rows) and states.forces_n is not None
    wrench = data.read("wrench", rows)[:, :3]
    np.testing.assert_allclose(states.forces_n.sum(axis=1), -wrench, atol=1e-5)
    depths = data.read("depth_mm", rows)
    assert np.abs(states.moved_mm[0]).max() < 0.01
    assert -np.nanmax(depths[-1]) <= states.moved_mm[-1, :, 2].min() < -0.05
    assert states.images is not None and len(states.images.rgb) == len(rows)
