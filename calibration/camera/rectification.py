# SPDX-License-Identifier: Apache-2.0
"""Maps that turn the camera's raw image into one with the same scale everywhere, and folders of
captures that were rectified so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial import Delaunay

from taccel_lab.calibration.camera.board_on_gel import OnGel
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.capture.folder import CaptureFolder, MarkerCaptures
from taccel_lab.calibration.capture.schema import MANIFEST_NAME, SCHEMA_VERSION, manifest_text
from taccel_lab.errors import InputError, naming
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.atomic_file import write_by, write_image
from taccel_lab.files.documents import read_toml
from taccel_lab.files.inner_path import copy_inner
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_shape

_CHUNK_PX = 100_000
_BEYOND_PITCHES = 1.0


@dataclass(frozen=True)
class RectificationMaps:
    """Places to look in the raw image for each pixel of the rectified one (``cv2.remap``)."""

    map_u_px: np.ndarray
    """float32, shape [height_px, width_px]; negative where the raw image shows nothing."""
    map_v_px: np.ndarray
    measured: np.ndarray
    """Pixels under the board or within a pitch of it, bool; the map is extrapolated elsewhere."""
    grid: PixelGrid | None
    """Pixels of the rectified image on the gel; None where the scale is not known."""
    raw_size_px: tuple[int, int] | None = None
    """Width and height of the raw images; None of maps that do not say."""

    @classmethod
    def load(cls, path: Path | str) -> RectificationMaps:
        """Read what ``save`` wrote of a board on the gel; InputError says what is wrong with it."""
        stored = read_npz(path)
        missing = [key for key in ("mm_per_px", "center_px") if key not in stored]
        if missing:
            raise InputError(
                f"{path} lacks {', '.join(missing)}; maps with a scale are written by "
                "taccel-lab calibrate camera --maps from a board on the gel"
            )
        u, v, scale, center = (
            finite_numbers(stored, key, path)
            for key in ("map_u_px", "map_v_px", "mm_per_px", "center_px")
        )
        measured = stored.get("measured", np.ones(u.shape, dtype=bool))
        size = stored.get("raw_size_px")
        with naming(path):
            require_shape("map_u_px", u, ("height", "width"))
            require_shape("map_v_px", v, u.shape)
            require_shape("mm_per_px", scale, (2,))
            require_shape("center_px", center, (2,))
            if measured.dtype.kind not in "biu":
                raise InputError(f"measured has type {measured.dtype}; bool is needed")
            require_shape("measured", measured, u.shape)
            if size is not None and (size.shape != (2,) or size.dtype.kind not in "iu"):
                raise InputError("raw_size_px has to be width and height in whole pixels")
            grid = PixelGrid(
                *u.shape[::-1], *scale.astype(float).tolist(), *center.astype(float).tolist()
            )
        raw = None if size is None else (int(size[0]), int(size[1]))
        return cls(u.astype(np.float32), v.astype(np.float32), measured.astype(bool), grid, raw)

    def require_grid(self) -> PixelGrid:
        """The rectified image's pixel grid; InputError where the scale is not known."""
        if self.grid is None:
            raise InputError(
                "these maps only remove the lens's distortion; a scale needs a board on the gel"
            )
        return self.grid

    def require_raw_size(self, size_px: tuple[int, int], source: str) -> None:
        """InputError unless images of ``source``, of (width, height), are what these rectify.

        Maps may reach past the image: what lies there is masked.
        """
        if self.raw_size_px is not None and self.raw_size_px != size_px:
            raise InputError(
                f"{source}: the maps were made for images of {self.raw_size_px[0]}x"
                f"{self.raw_size_px[1]} px, these are {size_px[0]}x{size_px[1]} px"
            )
        if not self.inside((size_px[1], size_px[0])).any():
            raise InputError(
                f"{source}: no pixel of the maps lies within images of {size_px[0]}x{size_px[1]} px"
            )

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The rectified image; black where the raw one shows nothing."""
        return cv2.remap(image, self.map_u_px, self.map_v_px, cv2.INTER_LINEAR)

    def inside(self, raw_size: tuple[int, int]) -> np.ndarray:
        """Pixels that the raw image, of (height, width), shows, bool."""
        height, width = raw_size
        u, v = self.map_u_px, self.map_v_px
        return (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)

    def save(self, path: Path | str) -> None:
        """Write an npz: map_u_px, map_v_px, measured, raw_size_px, mm_per_px and center_px."""
        about: dict[str, Any] = {}
        if self.raw_size_px is not None:
            about["raw_size_px"] = np.array(self.raw_size_px)
        if self.grid is not None:
            about["mm_per_px"] = np.array([self.grid.mm_per_px_x, self.grid.mm_per_px_y])
            about["center_px"] = np.array([self.grid.center_u_px, self.grid.center_v_px])
        about |= {"map_u_px": self.map_u_px, "map_v_px": self.map_v_px, "measured": self.measured}
        write_by(path, partial(np.savez_compressed, **about))


def gel_maps(on_gel: OnGel) -> RectificationMaps:
    """Maps to the pixel grid on the gel's face."""
    grid = on_gel.grid
    x, y = np.meshgrid(grid.x_mm(), grid.y_mm())
    xy = np.column_stack([x.ravel(), y.ravel()])
    uv = np.concatenate(
        [on_gel.pixel_from_gel(xy[k : k + _CHUNK_PX]) for k in range(0, len(xy), _CHUNK_PX)]
    )
    uv = np.where(np.isfinite(uv), uv, -1e4)
    points = on_gel.points_in_gel_mm
    pitch = float(on_gel.views[0].pitch_mm or 1.0)
    middle = points.mean(axis=0)
    away = points - middle
    length = np.linalg.norm(away, axis=1, keepdims=True)
    grown = middle + away * (1 + _BEYOND_PITCHES * pitch / np.maximum(length, pitch))
    measured = np.asarray(Delaunay(grown).find_simplex(xy)) >= 0
    u, v = uv.T.reshape(2, grid.height_px, grid.width_px).astype(np.float32)
    return RectificationMaps(u, v, measured.reshape(u.shape), grid, on_gel.views[0].size_px)


def lens_maps(intrinsics: Intrinsics) -> RectificationMaps:
    """Maps that remove the lens's distortion alone, at the same focal length."""
    lens, parameters = intrinsics.lens, intrinsics.parameters
    fx, fy, cx, cy = parameters[:4]
    width, height = intrinsics.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.column_stack([(u.ravel() - cx) / fx, (v.ravel() - cy) / fy, np.ones(u.size)])
    uv = lens.project(rays, parameters, np.zeros(6))
    inside = np.all((uv >= -1) & (uv <= (width, height)), axis=1)
    uv[~inside] = -1e4
    u, v = uv.T.reshape(2, height, width).astype(np.float32)
    return RectificationMaps(u, v, inside.reshape(u.shape), None, intrinsics.size_px)


LEFT_OUT = "{} were left out"
_Write = Callable[[str, np.ndarray], str]


def rectify_captures(
    folder: CaptureFolder, maps: RectificationMaps, out: Path, *, replace: bool = False
) -> list[str]:
    """Write the captures of ``folder``, rectified, as the capture folder ``out``.

    Images become PNG, videos numbered PNG; force records and paths are copied. Boards are left out,
    since the maps were made of them, and so are contact circles and edge lines, which are places in
    raw images: both are found again. Pixels that the raw image does not show are masked.

    Returns:
        What was left out, in sentences.

    Raises:
        InputError: Maps without a scale, or of another image size than the captures; captures in
            ``out`` where ``replace`` is not set.
    """
    grid = maps.require_grid()
    height, width = folder.require_background().image().shape[:2]
    maps.require_raw_size((width, height), folder.source)
    if not (folder.root / MANIFEST_NAME).is_file():
        raise InputError(
            f"{folder.source} has no {MANIFEST_NAME}; make a capture folder of it first "
            "(taccel-lab capture import)"
        )
    document = read_toml(folder.root / MANIFEST_NAME)
    notes: list[str] = []
    with atomic_directory(out, captures=replace) as target:

        def write(name: str, image: np.ndarray) -> str:
            """Write an image, rectified; returns its file name."""
            write_image(target / f"{name}.png", maps.apply(image))
            return f"{name}.png"

        document["schema_version"] = SCHEMA_VERSION
        document["rectified"] = True
        document["mm_per_px_x"], document["mm_per_px_y"] = grid.mm_per_px_x, grid.mm_per_px_y
        document.get("assumed", {}).pop("mm_per_px", None)  # The maps have measured it.
        if folder.background is not None:
            document["background"] = write("background", folder.background.image())
            document["mask"] = "mask.png"
            # Pixels that the raw image shows and that were not masked in it.
            usable = maps.inside((height, width))
            if folder.mask is not None:
                usable &= maps.apply(folder.mask.astype(np.uint8)) > 0
            write_image(target / "mask.png", usable.astype(np.uint8) * 255)
        if folder.untouched:
            document["untouched"] = [
                write(f"untouched_{i}", frame.image()) for i, frame in enumerate(folder.untouched)
            ]
        if document.get("presses"):
            document["presses"] = _presses(document["presses"], folder, write, notes)
        for i, (entry, edge) in enumerate(
            zip(document.get("edges", []), folder.edges, strict=True)
        ):
            entry["image"] = write(f"edge_{i:03d}", edge.frame.image())
            entry.pop("line", None)
        if document.pop("boards", None):
            notes.append(LEFT_OUT.format("boards"))
        if folder.markers is not None:
            document["markers"] = _markers(document["markers"], folder.markers, write)
        for entry in document.get("records", []):
            copy_inner(folder.root, entry["file"], target)
        # What the rectified images were made of: their own hashes say nothing about that.
        edges = (edge.frame for edge in folder.edges)
        raw = (folder.background, *folder.untouched, *folder.presses, *edges)
        document["raw_sha256"] = {"captures.toml": folder.provenance["manifest_sha256"]} | {
            Path(frame.source).name: frame.sha256 for frame in raw if frame is not None
        }
        (target / MANIFEST_NAME).write_text(manifest_text(document), encoding="utf-8")
    return notes


def _presses(
    entries: list[dict[str, Any]], folder: CaptureFolder, write: _Write, notes: list[str]
) -> list[dict[str, Any]]:
    """Entries of the presses that contacts.toml does not skip."""
    kept, skipped = [], []
    left = list(folder.presses)
    for entry in entries:
        name = entry.get("name") or Path(entry["image"]).stem
        # In the order of the manifest; two may have one name.
        if not left or left[0].name != name:
            skipped.append(name)
            continue
        i, press = len(kept), left.pop(0)
        entry["image"] = write(f"press_{i:03d}", press.image())
        entry.setdefault("name", press.name)
        if entry.pop("contact", None) is not None or press.checked:
            notes.append(f"the contact circle of {press.name} was left out")
        kept.append(entry)
    if skipped:
        notes.append(f"presses that contacts.toml skips were left out: {', '.join(skipped)}")
    return kept


def _markers(entry: dict[str, Any], markers: MarkerCaptures, write: _Write) -> dict[str, Any]:
    entry = {k: value for k, value in entry.items() if k not in ("labels", "labels_image")}
    if markers.rest is not None:
        entry["rest"] = write("markers_rest", markers.rest.image())
    videos = []
    for i, (table, video) in enumerate(zip(entry.get("videos", []), markers.videos, strict=True)):
        frames = [write(f"video_{i}_{k:05d}", frame) for k, frame in enumerate(video.frames())]
        kept = {key: value for key, value in table.items() if key not in ("file", "frames")}
        videos.append({**kept, "frames": frames})
    if videos:
        entry["videos"] = videos
    return entry
