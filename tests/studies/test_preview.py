# SPDX-License-Identifier: Apache-2.0
"""One design before it is built: pictures, photometry, and a press through the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taccel_lab.cli.app import main
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.studies import preview as previews
from taccel_lab.studies.camera_view import photometry
from taccel_lab.studies.preview import preview_design, write_preview
from tests.studies.coarse_presses import coarse


def test_dots_are_no_dark_spots_of_the_light() -> None:
    family = sensor_family("gelsight_mini")
    dotted = family.parameters()
    bare = family.parameters({"marker_pitch_mm": 0})
    assert dotted.markers() is not None and bare.markers() is None
    assert photometry(dotted) == photometry(bare)


def test_without_presses_there_are_pictures_and_photometry(tmp_path: Path) -> None:
    found = preview_design(sensor_family("digit"), {"mid_radius_mm": 25}, presses=(), size_px=96)
    assert found.pressed is None and found.result.simulations == 0
    assert {metric.name for metric in found.metrics} >= {"visible_fraction", "pixel_size"}
    # Nobody asked for the 32 starts of a task.
    assert not any(metric.runs_task for metric in found.metrics)
    files = write_preview(found, tmp_path)
    assert set(files) == {"figures", "overview", "rest"}
    stored = json.loads(files["figures"].read_text())
    assert stored["parameters"]["mid_radius_mm"] == 25
    assert stored["photometry"]["light_rank"] == found.photometry.light_rank
    image = np.asarray(Image.open(files["rest"]))
    assert image.shape == found.rest.rgb.shape and max(image.shape) == 96
    assert 0 < image[found.rest.mask].mean() < 255


def test_a_press_shows_in_picture_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = coarse("sphere", depth_fraction=0.15, steps=3)
    monkeypatch.setattr(previews, "standard_presses", lambda names: [ball])
    out = tmp_path / "out"
    arguments = ["preview", "gelsight", "--out", str(out), "--size-px", "96", "--json"]
    assert main(arguments) == 0
    stored = json.loads((out / "preview.json").read_text())
    (curve,) = stored["presses"]["sphere"]
    assert np.diff([0.0, *(force[2] for force in curve["force_n"])]).min() > 0
    assert stored["figures"]["contact_area"]["unit"] == "mm2"
    rest, pressed = (
        np.asarray(Image.open(out / f"{name}.png")).astype(int) for name in ("rest", "pressed")
    )
    change = np.abs(pressed - rest).sum(axis=-1)
    rows, columns = np.indices(change.shape)
    middle = np.hypot(rows - rows.mean(), columns - columns.mean()) < 0.3 * change.shape[0]
    assert change[middle].mean() > 5 * change[~middle].mean()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--presses", "hammer"], "no press 'hammer'; known: sphere"),
        (["--set", "thickness_mm=99"], "thickness_mm = 99 is above its bound"),
        (["--size-px", "4"], "size of a preview must lie in [32, 4096] px"),
        (["--device", "cuda:99"], "device 'cuda:99' is not there"),
    ],
)
def test_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    out = tmp_path / "out"
    assert main(["preview", "gelsight", "--out", str(out), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()
