# SPDX-License-Identifier: Apache-2.0
"""Small folders in the layouts of other projects."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.capture import CaptureFolder, import_captures, load_capture_folder
from taccel_lab.calibration.capture.importers import ImportOptions
from tests.support.capture_sets import write_image

RNG = np.random.default_rng(0)
EXAMPLES = Path(__file__).parents[3] / "docs" / "examples" / "layouts"


def picture(path: Path, level: int = 90, size: tuple[int, int] = (48, 64)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = RNG.integers(0, 30, (*size, 3), dtype=np.uint8) + np.uint8(level)
    write_image(path, image)
    return path


def pictures(folder: Path, *names: str, size: tuple[int, int] = (48, 64)) -> None:
    for name in names:
        picture(folder / (name if "." in name else f"{name}.png"), size=size)


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def taxim(folder: Path) -> None:
    np.savez(
        folder / "dataPack.npz",
        f0=np.full((48, 64, 3), 9, np.uint8),
        imgs=np.full((2, 48, 64, 3), 90, np.uint8),
        touch_center=np.array([[30.0, 24.0], [33.0, 24.0]]),
        touch_radius=np.array([12, 13]),
    )
    write_text(folder / "params.json", json.dumps({"sensor": {"pixmm": 0.1}}))


def fots(folder: Path) -> None:
    pictures(folder / "mlp_calib", "0000", "gelsight/0001", "gelsight/0002")
    pictures(folder / "mlp_calib", "scripts/0000", "digit/0005")
    pictures(folder / "marker_calib/data", "0")
    write_text(folder / "marker_calib/data/0.csv", "Mx,My,dx,dy\n25,11,-1,-2\n54,12,0,1\n")
    labels = "file,cx_px,cy_px,contact_r_px\nmlp_calib/gelsight/0002.png,30,20,12\n"
    write_text(folder / "labels_gelsight.csv", labels)


def ninedtact(folder: Path) -> None:
    for unit in ("sensor_1", "sensor_2"):
        for part in ("camera_calibration", "depth_calibration"):
            pictures(folder / "calibration" / unit / part, "ref", "sample", "sample_drawing")
    (folder / "shape_config.yaml").write_text(
        "camera_calibration:\n  row_points: 7\n  col_points: 9\n  grid_distance: 2.5\n"
        "depth_calibration:\n  BallRad: 4.0\n"
    )


def feats(folder: Path) -> None:
    record = {"indenter": "rigid sphere, radius 7.5 mm", "indentation_mm": [0.5, 1.0]}
    record["normal_force_N"] = [1.65, 5.96]
    write_text(folder / "force_indentation.json", json.dumps(record))
    np.save(folder / "homography.npy", np.array([[0.0, -14, 160], [-14, 0, 120], [0, 0, 1]]))


def gs_sdk(folder: Path) -> None:
    pictures(folder, "background")
    write_text(folder / "gsmini.yaml", "device_name: GelSight Mini\nppmm: 0.0634\n")
    rows = ["experiment_reldir,diameter(mm)"]
    for i, ball in enumerate((4.76, 4.76, 6.35)):
        place = folder / f"{ball:.3f}mm" / str(i)
        pictures(place, "gelsight")
        np.savez(place / "label.npz", center=np.array([30 + i, 22]), radius=11)
        rows.append(f"{ball:.3f}mm/{i},{ball}")
    write_text(folder / "catalog.csv", "\n".join(rows) + "\n")


def cube_edges(folder: Path) -> None:
    pictures(folder, "background")
    line = {"line_center": np.array([31.0, 20.0]), "line_length": 40, "line_angle": 4.0}
    for place in (folder / "0", folder / "2", folder / "10"):
        pictures(place, "gelsight")
        np.savez(place / "label.npz", **line)


def rvsathu(folder: Path) -> None:
    pictures(folder, "background_real", "calib_9_real", "calib_10_real")
    write_text(folder / "labels/res.txt", "calib_9_real.png (30, 21) 12\n")


def ruihangao(folder: Path) -> None:
    pictures(folder / "calib_ball", "frame_0.png", "frame_1.jpg", "frame_2.jpg")


def osaka(folder: Path) -> None:
    for i in range(3):
        pictures(folder, f"fisheye/cam2/{i}.jpg", f"cam2/{i}.jpg", size=(60, 80))
    pictures(folder, "cam2/tst4.jpg", size=(60, 80))


def gelslim(folder: Path) -> None:
    pictures(folder / "updated_calib", "ref.jpg", "sample_2.jpg", "sample_10.jpg")


def py3dcal(folder: Path) -> None:
    pictures(folder, "blank_images/blank", "probe_images/0")
    rows = "img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px\n0.png,1,2,0.8,30,20\n"
    write_text(folder / "annotations/annotations.csv", rows)
    about = json.dumps({"px_per_mm": 20.0, "probe_radius_mm": 2.0})
    write_text(folder / "annotations/metadata.json", about)


def printer(folder: Path) -> None:
    pictures(folder, "background", "press_000", "press_001")
    (folder / "printer_presses.csv").write_text(
        "image,x_mm,y_mm,depth_mm,radius_mm\npress_000.png,-3,2,0.4,2\npress_001.png,3,2,0.8,2\n"
    )


def dots_at(shift_px: float) -> np.ndarray:
    image = np.full((120, 160, 3), 170, np.uint8)
    for row in range(5):
        for column in range(7):
            center = (16 + 21 * column + shift_px, 16 + 21 * row)
            cv2.circle(image, tuple(round(16 * c) for c in center), 16 * 4, (30,) * 3, -1, 16, 4)
    return image


def markers(folder: Path) -> None:
    for i in range(25):
        write_image(folder / f"{i:04d}.png", dots_at(6 * np.sin(i / 8)))


def plain(folder: Path) -> None:
    pictures(folder, "bg", "a_1", "a_2", "a_10")
    pictures(folder, "other_camera", size=(60, 80))
    write_text(folder / "labels.csv", "name,x,y,radius\na_2.png,30,20,11\n")
    write_text(folder / "press.csv", "depth_mm,force_n\n0.2,0.1\n0.5,0.4\n")


MAKERS: dict[str, Callable[[Path], None]] = {
    "taxim": taxim, "9dtact": ninedtact, "gs-sdk": gs_sdk, "printer": printer,
    "markers": markers, "plain": plain,
}  # fmt: skip
SCRIPTED: dict[str, Callable[[Path], None]] = {
    "fots": fots, "feats": feats, "py3dcal": py3dcal, "cube-edges": cube_edges,
    "rvsathu": rvsathu, "ruihangao": ruihangao, "osaka": osaka, "gelslim": gelslim,
}  # fmt: skip
"""Published sets that scripts of the documentation read."""


def layout_of(which: str | Callable[[Path], None]) -> str:
    """What ``--layout`` says for the set of that name, or for what a maker writes."""
    names = [name for name, make in SCRIPTED.items() if which in (name, make)]
    return names[0] if names else "auto"


def source_of(name: str, folder: Path) -> Path:
    """The layout of that name below ``folder``."""
    source = folder / "source"
    source.mkdir(parents=True)
    (MAKERS | SCRIPTED)[name](source)
    return source


def imported(source: Path, layout: str = "auto", **options: Any) -> list[CaptureFolder]:
    """The capture folders that are made of it, beside it in ``out``."""
    out, facts = source.parent / "out", ImportOptions(**options)
    outs = import_captures(source, out, layout, facts, replace=True)
    return [load_capture_folder(out) for out in outs]


def only(name: str, folder: Path, **options: Any) -> CaptureFolder:
    """The one capture folder that is made of the layout of that name."""
    (captures,) = imported(source_of(name, folder), layout_of(name), **options)
    return captures


def manifest_of(source: Path) -> str:
    """Of what ``imported`` has made of it."""
    return (source.parent / "out" / "captures.toml").read_text(encoding="utf-8")
