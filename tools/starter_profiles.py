# SPDX-License-Identifier: Apache-2.0
"""Make the starter profiles of ``sensors/starters`` from published captures, with our calibration.

    python tools/starter_profiles.py ../shared/data [NAME ...]
    python tools/starter_profiles.py ../shared/data --teach NAME

The second command keeps a starter as it is, and teaches a small network what its ensemble reads.
Images are brought to the framing that users of the stock sensor have. Nothing is chosen by score:
presses that this framing cuts are left out, as the check of the captures names them.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from taccel_lab.calibration.calibrate import Calibration, calibrate
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.check import check_captures
from taccel_lab.calibration.normals.distilling import with_small_network
from taccel_lab.files.documents import read_toml
from taccel_lab.files.images import read_image
from taccel_lab.profile import save_profile
from taccel_lab.sensors.profile import stock_sensor
from taccel_lab.sensors.starters import ABOUT, STARTERS

UNIT_SHARE = 0.25
"""Standard deviation of slopes of other units, as a share of their tilt: that of the 90-degree
edges of every second of 16 cubes on another GelSight Mini (``gsmini_cube_edges``), beside the
stated one; the other eight have the same."""


@dataclass(frozen=True)
class Starter:
    """Where a starter comes from."""

    source: str
    copyright: str
    license_file: str
    """Path of the licence below the data folder; the file goes along."""
    framing: str
    """What images of the profile show, for its users."""
    blocks: tuple[str, ...]
    """What is fitted."""
    kept: tuple[str, ...]
    """Keys of the profile's blocks that are shipped."""
    captures: Callable[[Path, Path], dict[str, Any]]
    """Writes the images of a data folder into a capture folder; returns its manifest."""


def _mini(data: Path, folder: Path) -> dict[str, Any]:
    presses = []
    for path in sorted((data / "gsmini_ruihangao_calib/calib_ball").glob("frame_*.jpg")):
        image = cv2.imread(str(path))
        height, width = image.shape[:2]
        top, left = round(height / 7), round(width / 7)
        kept = image[top : height - top, left : width - left]
        cv2.imwrite(str(folder / f"{path.stem}.png"), cv2.resize(kept, (320, 240)))
        presses.append(path.stem)
    frames = [cv2.imread(str(folder / f"{name}.png")) for name in presses]
    cv2.imwrite(str(folder / "background.png"), np.median(frames, axis=0).round().astype(np.uint8))
    return {
        "sensor": "gelsight_mini",
        "mm_per_px_x": 0.0634,
        "mm_per_px_y": 0.0634,
        "indenter": {"kind": "sphere", "radius_mm": 2.0},
        "presses": [{"image": f"{name}.png"} for name in presses],
        "assumed": {
            "mm_per_px": "that of the catalogue, for the middle of the image",
            "radius_mm": "that of sensorParams.py of the published set",
            "background": "the median of the presses",
        },
    }


def _ninedtact(data: Path, folder: Path) -> dict[str, Any]:
    source = data / "9dtact_official/shape_reconstruction/calibration/sensor_1"
    for name, place in {
        "background": "depth_calibration/ref",
        "ball": "depth_calibration/sample",
        "board_reference": "camera_calibration/ref",
        "board": "camera_calibration/sample",
    }.items():
        image = cv2.imread(str(source / f"{place}.png"))
        cv2.imwrite(str(folder / f"{name}.png"), image[67 : 67 + 345, 90 : 90 + 460])
    board = {
        "kind": "dots", "columns": 9, "rows": 7, "pitch_mm": 2.5, "on_gel": True,
        "images": ["board.png"], "reference": "board_reference.png",
    }  # fmt: skip
    return {
        "sensor": "9dtact",
        "indenter": {"kind": "sphere", "radius_mm": 4.0},
        "presses": [{"image": "ball.png"}],
        "boards": [board],
        "assumed": {"radius_mm": "that of the authors"},
    }


MADE = {
    "gelsight_mini": Starter(
        "RuihanGao/16741-Proj-ShapeMap3D-GelSightMini, Taxim/data/Gel/11_19_2023",
        "Copyright (c) 2021 CMURoboTouch",
        "gsmini_ruihangao_calib/Taxim/LICENSE",
        "images: the middle 5/7 of the camera's width and of its height, at 320 x 240 px",
        ("background", "color", "normals"),
        ("background", "color", "normals"),
        _mini,
    ),
    "9dtact": Starter(
        "linchangyi1/9DTact, shape_reconstruction/calibration/sensor_1",
        "Copyright (c) 2026 Changyi Lin",
        "9dtact_official/LICENSE",
        "images: the middle 460 x 345 px of the camera's 640 x 480; lengths near their border are "
        "off by a quarter",
        ("scale", "background", "depth"),
        ("camera", "background", "depth_response"),
        _ninedtact,
    ),
}


def make(name: str, data: Path) -> None:
    """Calibrate one and write its folder and its entry."""
    starter = MADE[name]
    with tempfile.TemporaryDirectory() as scratch:
        found = _calibrated(starter, data, Path(scratch) / name)
    profile = found.profile
    assert profile.background is not None and profile.background_rgb is not None
    if profile.normals is not None:
        settings = {**profile.normals.architecture, "unit_share": UNIT_SHARE}
        profile = profile.with_block(
            profile.normals.model_copy(update={"architecture": settings}), profile.normal_weights
        )
    levels = np.rint(profile.background_rgb).astype(np.uint8)  # A quarter of the size.
    folder = STARTERS / name
    save_profile(profile.with_block(profile.background, levels), folder, starter.kept)
    about = read_toml(ABOUT) if ABOUT.is_file() else {}
    blocks = profile.blocks()
    about[name] = {
        "source": starter.source,
        "license": "MIT",
        "copyright": starter.copyright,
        "license_text": f"{name}.LICENSE",
        "framing": starter.framing,
        "command": f"python tools/starter_profiles.py DATA {name}",
        "scores": {key: dict(blocks[key].provenance.residuals) for key in starter.kept},
    }
    shutil.copyfile(data / starter.license_file, STARTERS / f"{name}.LICENSE")
    ABOUT.write_text(tomli_w.dumps(dict(sorted(about.items()))), encoding="utf-8")


def teach(name: str, data: Path) -> None:
    """Put a small network beside the ensemble of a starter, which stays as it is."""
    with tempfile.TemporaryDirectory() as scratch:
        manifest = MADE[name].captures(data, Path(scratch))
        photos = [read_image(Path(scratch) / press["image"]) for press in manifest["presses"]]
    profile = with_small_network(stock_sensor(name), photos)
    save_profile(profile, STARTERS / name, MADE[name].kept)


def _calibrated(starter: Starter, data: Path, folder: Path) -> Calibration:
    folder.mkdir()
    manifest = {
        "schema_version": 2,
        "background": "background.png",
        "source": starter.source,
        "license": "MIT",
        **starter.captures(data, folder),
    }
    path = folder / "captures.toml"
    path.write_text(tomli_w.dumps(manifest), encoding="utf-8")
    findings = check_captures(load_capture_folder(folder)).findings
    cut = {frame for found in findings if found.code == "no_contact" for frame in found.frames}
    kept = [press for press in manifest["presses"] if Path(press["image"]).stem not in cut]
    path.write_text(tomli_w.dumps({**manifest, "presses": kept}), encoding="utf-8")
    return calibrate(folder, only=starter.blocks)


if __name__ == "__main__":
    _, data_folder, *names = sys.argv
    work = teach if "--teach" in names else make
    for wanted in [name for name in names if name != "--teach"] or MADE:
        work(wanted, Path(data_folder))
