# SPDX-License-Identifier: Apache-2.0
"""The ball presses that ship in the PyPI wheel ``taxim`` (MIT), read from their ``dataPack.npz``.

Layout of the file (Si and Yuan, "Taxim: an example-based simulation model for GelSight tactile
sensors", RA-L 2022, and the wheel's ``calibration.py``): ``f0`` background and ``imgs`` frames in
BGR, ``touch_center`` (u, v) and ``touch_radius`` in px; the scale is ``sensor.pixmm`` of the
``params.json`` beside it. The ball's radius of 2.0 mm is Taxim's documented default and appears
nowhere in the wheel.
"""

from __future__ import annotations

import hashlib
import importlib.util
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle, Frame
from taccel_lab.calibration.capture.folder import CaptureFolder, in_words
from taccel_lab.calibration.capture.schema import MAX_MM_PER_PX, MIN_MM_PER_PX
from taccel_lab.errors import InputError, naming
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.documents import number_at, read_json
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.guards import require_shape

PACK_NAME = "dataPack.npz"
PACK_PATH_IN_WHEEL = Path("calib") / "gelsight" / PACK_NAME
TAXIM_BALL_RADIUS_MM = 2.0
REQUIRED_KEYS = ("f0", "imgs", "touch_center", "touch_radius")
PARAMS_NAME = "params.json"
TAXIM_BALL_WHY = "Taxim's documented default, which no file states; --radius-mm gives another"
PUBLISHED = {
    "090d348cb7f5ea5ad1d68c147580048780f507bc0e43aa656c3dbf4d667af5c6": (
        "PyPI wheel taxim, calib/gelsight/dataPack.npz (Taxim, Si and Yuan 2022)"
    ),
    "a728d126e6c6bea277ad2511c459af2f684829143be9d9d9cfce49932a169bc1": (
        "PyPI wheel taxim, calib/gelsight_mini/dataPack.npz"
    ),
}
"""Sources of the packs that the wheel (MIT) ships, by SHA-256; where others are from is unknown."""


def find_taxim_pack() -> Path:
    """Path of the GelSight ``dataPack.npz`` of the installed ``taxim`` wheel.

    The package is located without importing it: its import pulls in a renderer this needs not.
    """
    spec = importlib.util.find_spec("taxim")
    if spec is None or spec.origin is None:
        raise InputError(
            "the package taxim is not installed; install the extra 'demo' or give the path of a "
            "dataPack.npz"
        )
    path = Path(spec.origin).parent / PACK_PATH_IN_WHEEL
    if not path.is_file():
        raise InputError(f"{path} is missing from the installed taxim package; reinstall taxim")
    return path


def load_taxim_folder(path: Path, mm_per_px: tuple[float, float] | None = None) -> CaptureFolder:
    """Captures of a Taxim ``dataPack.npz``; the scale is ``mm_per_px``, or else comes from the
    ``params.json`` beside it.

    The wheel's ``gelsight_mini`` was recorded with another ball, whose radius is stated nowhere, so
    it is left open there.
    """
    if mm_per_px is None:
        stated = _read_scale(inner_path(path.parent, PARAMS_NAME), path)
        mm_per_px = stated, stated
    # Only these are read, so no pickle has to be trusted.
    arrays = read_npz(path, REQUIRED_KEYS, f"a Taxim pack holds {', '.join(REQUIRED_KEYS)}")
    images = arrays["imgs"]
    centers, radii = (finite_numbers(arrays, key, path) for key in ("touch_center", "touch_radius"))
    _check_arrays(path, arrays["f0"], images, centers, radii)
    background = np.ascontiguousarray(arrays["f0"][..., ::-1])
    presses = tuple(
        CapturedPress(
            # Positional: the pack's own name list is one longer than its frames.
            name=f"press_{i:03d}",
            source=f"{path}[{i}]",
            sha256=hashlib.sha256(images[i].tobytes()).hexdigest(),
            circle=ContactCircle(float(centers[i, 0]), float(centers[i, 1]), float(radii[i])),
            read=partial(_rgb_frame, images, i),
        )
        for i in range(len(images))
    )
    folder = real_path(path).parent.name
    mini = "mini" in folder.lower()
    sensor = "gelsight_mini" if mini else "gelsight"
    assumed = {"sensor": f"{sensor}, by the name of the folder, {folder}"}
    if not mini:
        assumed["radius_mm"] = f"{TAXIM_BALL_RADIUS_MM:g} mm, {TAXIM_BALL_WHY}"
    pack_sha256 = file_sha256(path)
    provenance = {"pack_sha256": pack_sha256, "assumed": in_words(assumed)}
    if pack_sha256 in PUBLISHED:
        provenance |= {"source": PUBLISHED[pack_sha256], "license": "MIT"}
    return CaptureFolder(
        source=str(path),
        root=path.parent,
        sensor=sensor,
        unit=None,
        background=Frame(
            "background",
            f"{path}[f0]",
            hashlib.sha256(arrays["f0"].tobytes()).hexdigest(),
            partial(np.copy, background),
        ),
        untouched=(),
        mask=None,
        mm_per_px=mm_per_px,
        ball_radius_mm=None if mini else TAXIM_BALL_RADIUS_MM,
        presses=presses,
        provenance=provenance,
        assumed=assumed,
    )


def _rgb_frame(images: np.ndarray, index: int) -> np.ndarray:
    return np.ascontiguousarray(images[index][..., ::-1])


def _read_scale(params_path: Path, pack_path: Path) -> float:
    if not params_path.is_file():
        raise InputError(
            f"{params_path} is missing; the scale of {pack_path} is read from it, or given to "
            "taccel-lab capture import with --mm-per-px-x"
        )
    scale = number_at(read_json(params_path), "sensor.pixmm", str(params_path))
    if not MIN_MM_PER_PX <= scale <= MAX_MM_PER_PX:
        raise InputError(
            f"{params_path}: sensor.pixmm is {scale:g}; {MIN_MM_PER_PX:g} to {MAX_MM_PER_PX:g} "
            "mm/px is allowed"
        )
    return scale


def _check_arrays(
    path: Path,
    background: np.ndarray,
    images: np.ndarray,
    centers: np.ndarray,
    radii: np.ndarray,
) -> None:
    with naming(path):
        for name, levels in (("f0", background), ("imgs", images)):
            if levels.dtype != np.uint8:
                raise InputError(f"{name} has type {levels.dtype}; uint8 levels are needed")
        require_shape("f0", background, ("height", "width", 3))
        require_shape("imgs", images, ("frames", *background.shape))
        if len(images) == 0:
            raise InputError("imgs is empty; at least one frame is needed")
        require_shape("touch_center", centers, (len(images), 2))
        require_shape("touch_radius", radii, (len(images),))
