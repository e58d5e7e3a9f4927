# SPDX-License-Identifier: Apache-2.0
"""Read a capture folder (``captures.toml``) or a Taxim ``dataPack.npz``, refusing what is unfit."""

from __future__ import annotations

import hashlib
import tomllib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from pydantic import ValidationError

from calibration.capture.captures import CaptureSet, ContactCircle, Press
from calibration.capture.schema import MANIFEST_NAME, CaptureManifest
from calibration.capture.taxim_pack import load_taxim_pack
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

MIN_SIZE_PX = 32


def load_captures(path: Path | str) -> CaptureSet:
    """Load captures from a folder with ``captures.toml`` or from a Taxim ``dataPack.npz``.

    Every file is read and checked once; the images of the presses are then read again on demand.
    Raises InputError naming the file, what was found and what is allowed.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(
            f"{path} does not exist; a capture folder with {MANIFEST_NAME} or a Taxim "
            "dataPack.npz is needed"
        )
    if path.is_file() and path.suffix == ".npz":
        return load_taxim_pack(path)
    manifest_path = path if path.name == MANIFEST_NAME else path / MANIFEST_NAME
    if not manifest_path.is_file():
        found = "an empty folder" if path.is_dir() and not any(path.iterdir()) else "no manifest"
        raise InputError(
            f"{path}: {found}; a capture folder holds {MANIFEST_NAME} (see docs/captures.md)"
        )
    return _load_folder(manifest_path)


def read_manifest(path: Path) -> CaptureManifest:
    """Parse and validate ``captures.toml``; unknown keys are refused."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid TOML: {error}") from error
    try:
        return CaptureManifest.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {describe_validation_error(error)}") from error


def describe_validation_error(error: ValidationError) -> str:
    """One line per fault: where in the manifest, what is wrong, what was found."""
    lines = []
    for fault in error.errors():
        where = ".".join(str(part) for part in fault["loc"]) or "manifest"
        value = fault.get("input")
        found = f" (found {value!r})" if isinstance(value, (str, int, float)) else ""
        lines.append(f"{where}: {fault['msg']}{found}")
    return "; ".join(lines)


def read_image(path: Path) -> np.ndarray:
    """Read an image file as RGB uint8, shape [height, width, 3]."""
    image = _decode(path, cv2.IMREAD_COLOR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _decode(path: Path, flags: int) -> np.ndarray:
    if not path.is_file():
        raise InputError(f"{path} does not exist; the manifest names it")
    # Decoding from memory keeps OpenCV from printing its own warning for a broken file.
    data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, flags) if data.size else None
    if image is None:
        raise InputError(f"{path} is not an image that can be read; PNG or JPEG is allowed")
    return image


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _load_folder(manifest_path: Path) -> CaptureSet:
    manifest = read_manifest(manifest_path)
    folder = manifest_path.parent
    background_path = folder / manifest.background
    background = read_image(background_path)
    height, width = background.shape[:2]
    if min(height, width) < MIN_SIZE_PX:
        raise InputError(
            f"{background_path} is {width}x{height} px; at least {MIN_SIZE_PX}x{MIN_SIZE_PX} px"
        )
    mask = np.ones((height, width), dtype=bool)
    if manifest.mask is not None:
        grey = _decode(folder / manifest.mask, cv2.IMREAD_GRAYSCALE)
        _check_size(grey, background, folder / manifest.mask, background_path)
        mask = grey > 0
        if not mask.any():
            raise InputError(
                f"{folder / manifest.mask} masks every pixel; some have to be non-zero"
            )
    presses = []
    for entry in manifest.presses:
        image_path = folder / entry.image
        _check_size(read_image(image_path), background, image_path, background_path)
        circle = None
        if entry.contact is not None:
            circle = ContactCircle(**entry.contact.model_dump())
        presses.append(
            Press(
                name=entry.name or image_path.stem,
                source=str(image_path),
                sha256=file_sha256(image_path),
                circle=circle,
                read=partial(read_image, image_path),
            )
        )
    provenance = {"manifest_sha256": file_sha256(manifest_path)}
    if manifest.source is not None:
        provenance["source"] = manifest.source
    if manifest.license is not None:
        provenance["license"] = manifest.license
    return CaptureSet(
        source=str(manifest_path),
        sensor=manifest.sensor,
        background=background,
        background_sha256=file_sha256(background_path),
        mask=mask,
        ball_radius_mm=manifest.indenter.radius_mm,
        grid=PixelGrid(
            width_px=width,
            height_px=height,
            mm_per_px_x=manifest.mm_per_px_x,
            mm_per_px_y=manifest.mm_per_px_y,
        ),
        presses=tuple(presses),
        provenance=provenance,
    )


def _check_size(image: np.ndarray, reference: np.ndarray, path: Path, reference_path: Path) -> None:
    if image.shape[:2] != reference.shape[:2]:
        raise InputError(
            f"{path} is {image.shape[1]}x{image.shape[0]} px but the background {reference_path} "
            f"is {reference.shape[1]}x{reference.shape[0]} px; all images have to be of one size"
        )
