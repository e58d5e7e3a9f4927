# SPDX-License-Identifier: Apache-2.0
"""Read a capture folder (``captures.toml``, ``contacts.toml``) or a Taxim ``dataPack.npz``: what is
unfit is refused.
"""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress, CaptureSet, ContactCircle, Frame
from taccel_lab.calibration.capture.contacts_file import CONTACTS_NAME, override_presses
from taccel_lab.calibration.capture.folder import (
    BoardCaptures,
    CaptureFolder,
    EdgeCapture,
    MarkerCaptures,
    Video,
    in_words,
)
from taccel_lab.calibration.capture.records import load_record, read_columns
from taccel_lab.calibration.capture.schema import (
    MANIFEST_NAME,
    CaptureManifest,
    MarkersEntry,
    VideoEntry,
)
from taccel_lab.calibration.capture.taxim_pack import load_taxim_folder
from taccel_lab.errors import InputError
from taccel_lab.files.images import KeptImages, read_grey
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.files.videos import count_frames, read_frames
from taccel_lab.guards import require_size
from taccel_lab.sensors.registry import profile_folder

MIN_SIZE_PX = 32
_Sized = tuple[str, tuple[int, int]]
"""An image file, and its width and height [px]."""


def load_captures(path: Path | str) -> CaptureSet:
    """The ball presses of a capture folder, or of a Taxim ``dataPack.npz``.

    Every file is read and checked.
    Raises InputError naming the file, what was found and what is allowed.
    """
    return load_capture_folder(path).ball_presses()


def load_capture_folder(path: Path | str, *, corrected: bool = True) -> CaptureFolder:
    """Load everything that ``captures.toml`` names, checked; each image is decoded once.

    ``path`` is the folder, its manifest, or a Taxim ``dataPack.npz``; ``corrected``: whether
    ``contacts.toml`` beside the manifest has its say.

    Raises:
        InputError: Names the file, what was found and what is allowed.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(
            f"{path} does not exist; a capture folder with {MANIFEST_NAME} or a Taxim "
            "dataPack.npz is needed"
        )
    if path.is_file() and path.suffix == ".npz":
        return load_taxim_folder(path)
    manifest_path = path if path.name == MANIFEST_NAME else inner_path(path, MANIFEST_NAME)
    if not manifest_path.is_file():
        found = "an empty folder" if path.is_dir() and not any(path.iterdir()) else "no manifest"
        raise InputError(
            f"{path}: {found}; a capture folder holds {MANIFEST_NAME} (see docs/captures.md); "
            "taccel-lab capture import makes one of a folder in another layout"
        )
    return _load_folder(manifest_path, corrected)


def _sensor(manifest_path: Path, name: str) -> str:
    """The name of a family as it is, the folder of a profile absolute."""
    if "/" not in name:
        return name
    folder = profile_folder(manifest_path.parent / name)
    if folder is None:
        raise InputError(
            f"{manifest_path}: sensor = {name!r} is no folder of a profile; name one, relative to "
            "this file, or a sensor of the catalogue (taccel-lab sensors list)"
        )
    return str(folder)


def _load_folder(manifest_path: Path, corrected: bool) -> CaptureFolder:
    manifest = CaptureManifest.read(manifest_path)
    folder = manifest_path.parent
    images = KeptImages()
    background = like = None
    if manifest.background is not None:
        background = image_frame(images, folder, manifest.background)
        height, width = background.image().shape[:2]
        like = background.source, (width, height)
        if min(height, width) < MIN_SIZE_PX:
            raise InputError(
                f"{background.source} is {width}x{height} px; at least "
                f"{MIN_SIZE_PX}x{MIN_SIZE_PX} px"
            )
    presses = []
    for entry in manifest.presses:
        frame = _frame(images, folder, entry.image, like)
        circle = None
        if entry.contact is not None:
            circle = ContactCircle(**entry.contact.model_dump())
        name = entry.name or frame.name
        said = entry.model_dump(include={"radius_mm", "depth_mm", "force_n", "stage_mm"})
        presses.append(CapturedPress(name, frame.source, frame.sha256, frame.read, circle, **said))
    provenance = {"manifest_sha256": file_sha256(manifest_path)}
    contacts = inner_path(folder, CONTACTS_NAME)
    if corrected and contacts.is_file():
        presses = list(override_presses(presses, contacts))
        provenance["contacts_sha256"] = file_sha256(contacts)
    if "captures.toml" in manifest.raw_sha256:
        provenance["raw_manifest_sha256"] = manifest.raw_sha256["captures.toml"]
    if manifest.source is not None:
        provenance["source"] = manifest.source
    if manifest.license is not None:
        provenance["license"] = manifest.license
    if manifest.assumed:
        provenance["assumed"] = in_words(manifest.assumed)
    scale = (manifest.mm_per_px_x, manifest.mm_per_px_y)
    if (scale[0] is None) != (scale[1] is None):
        raise InputError(f"{manifest_path}: give both mm_per_px_x and mm_per_px_y, or neither")
    return CaptureFolder(
        source=str(manifest_path),
        root=folder,
        sensor=_sensor(manifest_path, manifest.sensor),
        unit=manifest.unit,
        background=background,
        untouched=tuple(_frame(images, folder, name, like) for name in manifest.untouched),
        mask=_load_mask(folder, manifest.mask, like),
        mm_per_px=None if scale[0] is None or scale[1] is None else (scale[0], scale[1]),
        ball_radius_mm=None if manifest.indenter is None else manifest.indenter.radius_mm,
        by_diameter=manifest.indenter is not None and manifest.indenter.diameter_mm is not None,
        presses=tuple(presses),
        boards=tuple(
            BoardCaptures(
                entry,
                tuple(image_frame(images, folder, name) for name in entry.images),
                background
                if entry.reference is None
                else image_frame(images, folder, entry.reference),
            )
            for entry in manifest.boards
        ),
        edges=tuple(
            EdgeCapture(entry, _frame(images, folder, entry.image, like))
            for entry in manifest.edges
        ),
        markers=None
        if manifest.markers is None
        else load_markers(images, folder, manifest.markers, background),
        records=tuple(load_record(folder, entry) for entry in manifest.records),
        provenance=provenance,
        heldout=_heldout(manifest, manifest_path),
        rectified=manifest.rectified,
        design=dict(manifest.design),
        assumed=manifest.assumed,
        recorded=manifest.recorded,
    )


def _heldout(manifest: CaptureManifest, path: Path) -> tuple[str, ...] | None:
    """Names that the manifest holds out; each has to be one of its presses."""
    if manifest.split is None:
        return None
    known = {entry.name or Path(entry.image).stem for entry in manifest.presses}
    unknown = [name for name in manifest.split.heldout if name not in known]
    if unknown:
        raise InputError(
            f"{path}: [split] holds out {', '.join(unknown)}, but there is no such press; names "
            "are those of the presses, or the stems of their images"
        )
    return tuple(manifest.split.heldout)


def _load_mask(folder: Path, name: str | None, like: _Sized | None) -> np.ndarray | None:
    if name is None:
        return None
    path = inner_path(folder, name)
    grey = read_grey(path)
    _check_size((grey.shape[1], grey.shape[0]), path, like)
    if not (grey > 0).any():
        raise InputError(f"{path} masks every pixel; some have to be non-zero")
    return grey > 0


def _frame(images: KeptImages, folder: Path, name: str, like: _Sized | None) -> Frame:
    """An image file of the size of ``like``, where that is given."""
    frame = image_frame(images, folder, name)
    height, width = frame.image().shape[:2]
    _check_size((width, height), Path(frame.source), like)
    return frame


def _check_size(size: tuple[int, int], path: Path, like: _Sized | None) -> None:
    if like is not None:
        advice = "all images have to be of one size"
        require_size(str(path), size, f"the background {like[0]} is", like[1], advice)


LOST_SHARE = 0.95
"""Share of the frames that a file states, of which as many have to decode."""


def load_markers(
    images: KeptImages, folder: Path, entry: MarkersEntry, background: Frame | None
) -> MarkerCaptures:
    """The dots at rest and their videos; InputError when there is no picture of dots at all."""
    rest = background if entry.rest is None else image_frame(images, folder, entry.rest)
    of_labels = None
    if entry.labels_image is not None:
        of_labels = image_frame(images, folder, entry.labels_image)
    if rest is None and of_labels is None and not entry.videos:
        raise InputError(
            f"{folder}: markers need an image at rest (markers.rest or background), or a video"
        )
    videos = tuple(load_video(images, folder, video) for video in entry.videos)
    labels = {} if entry.labels is None else read_columns(inner_path(folder, entry.labels))
    missing = {"u_px", "v_px", "du_px", "dv_px"} - labels.keys()
    if labels and missing:
        raise InputError(f"{folder / str(entry.labels)} lacks {', '.join(sorted(missing))}")
    return MarkerCaptures(rest, entry.pitch_x_mm, entry.pitch_y_mm, videos, labels, of_labels)


def image_frame(images: KeptImages, folder: Path, name: str) -> Frame:
    """An image file; InputError where it cannot be decoded."""
    path = inner_path(folder, name)
    images.read(path)
    return Frame(path.stem, str(path), file_sha256(path), partial(images.read, path))


def load_video(images: KeptImages, folder: Path, entry: VideoEntry) -> Video:
    """One motion; InputError when it does not decode or holds fewer than two frames."""
    if (entry.file is None) == (not entry.frames):
        raise InputError(f"{folder}: a video needs either a file or frames, and not both")
    if entry.file is not None:
        path = inner_path(folder, entry.file)
        count, stated = count_frames(path)
        read = partial(read_frames, path)
        return Video(entry, str(path), file_sha256(path), count, read, stated)
    paths = [path for name in entry.frames for path in _expand(folder, name)]
    if len(paths) < 2:
        raise InputError(f"{folder}: a video needs at least 2 frames, found {len(paths)}")
    digest = hashlib.sha256("".join(file_sha256(path) for path in paths).encode()).hexdigest()
    return Video(entry, str(paths[0]), digest, len(paths), lambda: map(images.read, paths))


def cut_short(video: Video) -> str | None:
    """Says so when clearly fewer frames decode than the file states; None when all do."""
    if video.frame_count >= LOST_SHARE * video.stated_count:
        return None
    return (
        f"{video.source}: {video.frame_count} of the {video.stated_count} frames that it states "
        "can be read: the file is damaged or was not closed"
    )


def _expand(folder: Path, name: str) -> list[Path]:
    """Files of a name, which may hold wildcards."""
    wild = any(c in name for c in "*?[")
    paths = sorted(folder.glob(name)) if wild else [folder / name]
    return [inner_path(folder, path.relative_to(folder).as_posix()) for path in paths]
