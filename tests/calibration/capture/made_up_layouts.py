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


def picture(path: Path, level: int = 90, size: tuple[int, int] = (48, 64)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = RNG.integers(0, 30, (*size, 3), dtype=np.uint8) + np.uint8(level)
    write_image(path, image)
    return path


def taxim(folder: Path) -> None:
    np.savez(
        folder / "dataPack.npz",
        f0=np.full((48, 64, 3), 9, np.uint8),
        imgs=np.full((2, 48, 64, 3), 90, np.uint8),
        touch_center=np.array([[30.0, 24.0], [33.0, 24.0]]),
        touch_radius=np.array([12, 13]),
    )
    (folder / "params.json").write_text(json.dumps({"sensor": {"pixmm": 0.1}}))


def fots(folder: Path) -> None:
    for name in ("mlp_calib/0000", "mlp_calib/gelsight/0001", "mlp_calib/gelsight/0002"):
        picture(folder / f"{name}.png")
    for name in ("mlp_calib/scripts/0000", "mlp_calib/digit/0005"):
        picture(folder / f"{name}.png")
    picture(folder / "marker_calib" / "data" / "0.png")
    (folder / "marker_calib" / "data" / "0.csv").write_text("Mx,My,dx,dy\n25,11,-1,-2\n54,12,0,1\n")
    (folder / "labels_gelsight.csv").write_text(
        "file,cx_px,cy_px,contact_r_px\nmlp_calib/gelsight/0002.png,30,20,12\n"
    )


def ninedtact(folder: Path) -> None:
    for unit in ("sensor_1", "sensor_2"):
        for part in ("camera_calibration", "depth_calibration"):
            for name in ("ref", "sample", "sample_drawing"):
                picture(folder / "calibration" / unit / part / f"{name}.png")
    (folder / "shape_config.yaml").write_text(
        "camera_calibration:\n  row_points: 7\n  col_points: 9\n  grid_distance: 2.5\n"
        "depth_calibration:\n  BallRad: 4.0\n"
    )


def feats(folder: Path) -> None:
    (folder / "force_indentation.json").write_text(
        json.dumps(
            {
                "indenter": "rigid sphere, radius 7.5 mm",
                "indentation_mm": [0.5, 1.0],
                "normal_force_N": [1.65, 5.96],
            }
        )
    )
    np.save(folder / "homography.npy", np.array([[0.0, -14, 160], [-14, 0, 120], [0, 0, 1]]))


def gs_sdk(folder: Path) -> None:
    picture(folder / "background.png")
    (folder / "gsmini.yaml").write_text("device_name: GelSight Mini\nppmm: 0.0634\n")
    rows = ["experiment_reldir,diameter(mm)"]
    for i, ball in enumerate((4.76, 4.76, 6.35)):
        place = folder / f"{ball:.3f}mm" / str(i)
        picture(place / "gelsight.png")
        np.savez(place / "label.npz", center=np.array([30 + i, 22]), radius=11)
        rows.append(f"{ball:.3f}mm/{i},{ball}")
    (folder / "catalog.csv").write_text("\n".join(rows) + "\n")


def cube_edges(folder: Path) -> None:
    picture(folder / "background.png")
    for i in (0, 2, 10):
        picture(folder / str(i) / "gelsight.png")
        np.savez(
            folder / str(i) / "label.npz",
            line_center=np.array([31.0, 20.0]), line_length=40, line_angle=4.0,
        )  # fmt: skip


def rvsathu(folder: Path) -> None:
    picture(folder / "background_real.png")
    picture(folder / "calib_9_real.png")
    picture(folder / "calib_10_real.png")
    (folder / "labels").mkdir()
    (folder / "labels" / "res.txt").write_text("calib_9_real.png (30, 21) 12\n")


def ruihangao(folder: Path) -> None:
    for i in range(3):
        picture(folder / "calib_ball" / f"frame_{i}.{'png' if i == 0 else 'jpg'}")


def osaka(folder: Path) -> None:
    for i in range(3):
        picture(folder / "fisheye" / "cam2" / f"{i}.jpg", size=(60, 80))
        picture(folder / "cam2" / f"{i}.jpg", size=(60, 80))
    picture(folder / "cam2" / "tst4.jpg", size=(60, 80))


def gelslim(folder: Path) -> None:
    for name in ("ref", "sample_2", "sample_10"):
        picture(folder / "updated_calib" / f"{name}.jpg")


def py3dcal(folder: Path) -> None:
    picture(folder / "blank_images" / "blank.png")
    picture(folder / "probe_images" / "0.png")
    (folder / "annotations").mkdir()
    (folder / "annotations" / "annotations.csv").write_text(
        "img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px\n0.png,1,2,0.8,30,20\n"
    )
    (folder / "annotations" / "metadata.json").write_text(
        json.dumps({"px_per_mm": 20.0, "probe_radius_mm": 2.0})
    )


def printer(folder: Path) -> None:
    for name in ("background", "press_000", "press_001"):
        picture(folder / f"{name}.png")
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
    for name in ("bg", "a_1", "a_2", "a_10"):
        picture(folder / f"{name}.png")
    picture(folder / "other_camera.png", size=(60, 80))
    (folder / "labels.csv").write_text("name,x,y,radius\na_2.png,30,20,11\n")
    (folder / "press.csv").write_text("depth_mm,force_n\n0.2,0.1\n0.5,0.4\n")


MAKERS: dict[str, Callable[[Path], None]] = {
    "taxim": taxim, "9dtact": ninedtact, "gs-sdk": gs_sdk, "printer": printer,
    "markers": markers, "plain": plain,
}  # fmt: skip
SCRIPTED: dict[str, Callable[[Path], None]] = {
    "fots": fots, "feats": feats, "py3dcal": py3dcal, "cube-edges": cube_edges,
    "rvsathu": rvsathu, "ruihangao": ruihangao, "osaka": osaka, "gelslim": gelslim,
}  # fmt: skip
"""Published sets that scripts of the documentation read."""
SCRIPTS = Path(__file__).parents[3] / "docs" / "examples" / "layouts"


def layout_of(make: Callable[[Path], None]) -> str:
    """What ``--layout`` says for what ``make`` writes."""
    scripts = [str(SCRIPTS / f"{name}.py") for name, other in SCRIPTED.items() if other is make]
    return scripts[0] if scripts else "auto"


def source_of(make: Callable[[Path], None], folder: Path) -> Path:
    """A layout below ``folder``."""
    source = folder / "source"
    source.mkdir()
    make(source)
    return source


def imported(source: Path, layout: str = "auto", **options: Any) -> list[CaptureFolder]:
    """The capture folders that are made of it, beside it in ``out``."""
    outs = import_captures(source, source.parent / "out", layout, ImportOptions(**options))
    return [load_capture_folder(out) for out in outs]
