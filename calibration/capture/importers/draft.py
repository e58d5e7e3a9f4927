# SPDX-License-Identifier: Apache-2.0
"""What a layout provides: capture folders in the making, ready to be written or opened."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.capture.camera.recording import is_picture
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.framing import (
    BACKGROUND_NAME,
    median_image,
)
from taccel_lab.calibration.capture.importers.files import UNKNOWN, images_in, left_out_sentences
from taccel_lab.calibration.capture.importers.label_tables import (
    NAMES,
    LabelTables,
    read_label_tables,
)
from taccel_lab.calibration.capture.load import load_capture_folder
from taccel_lab.calibration.capture.schema import (
    MANIFEST_NAME,
    MAX_EDGE_MM,
    MAX_MM_PER_PX,
    MAX_RADIUS_MM,
    MIN_EDGE_MM,
    MIN_MM_PER_PX,
    MIN_RADIUS_MM,
    SCHEMA_VERSION,
    manifest_text,
)
from taccel_lab.calibration.capture.sensor_facts import USUAL, catalogue_scale
from taccel_lab.calibration.import_options import ImportOptions
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_image
from taccel_lab.files.images import MAX_FILE_BYTES, Image, levels, read_image
from taccel_lab.files.regular_file import LARGEST_BYTES, file_sha256, require_regular_file
from taccel_lab.files.table_file import number
from taccel_lab.printable import printable
from taccel_lab.sensors.registry import known_sensor, profile_folder, sensor_family

COPIED_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Image files whose bytes are kept; others become PNG, which loses nothing."""
MEDIAN = "median"
FALLBACK_SENSOR = "flat_pad"
"""Where nothing says which sensor the captures are of."""
ANY_FLAT_GEL = "which stands for any flat gel; --sensor names another"
_BOARD = re.compile(r"^(chessboard|charuco|dots):([0-9]{1,4})x([0-9]{1,4})(?::([0-9.]+))?$")
_NAME_BYTES = 240
"""Most bytes of a file's name, whose copies are numbered; systems take 255."""
_SCALES = (MIN_MM_PER_PX, MAX_MM_PER_PX)
_BOUNDS = {
    "radius_mm": (MIN_RADIUS_MM, MAX_RADIUS_MM),
    "mm_per_px_x": _SCALES,
    "mm_per_px_y": _SCALES,
    "edge_mm": (MIN_EDGE_MM, MAX_EDGE_MM),
}
"""What the manifest allows."""


def require_lengths(**lengths: float | None) -> None:
    """InputError for an option out of the manifest's bounds; by the options' names, None: not
    given."""
    for name, value in lengths.items():
        least, most = _BOUNDS[name]
        if value is None or least < value <= most:
            continue
        unit = "mm/px" if name.startswith("mm_per_px") else "mm"
        meant = value * 1e3
        hint = f"; is it in metres ({meant:g} {unit})?" if least < meant <= most else ""
        raise InputError(
            f"--{name.replace('_', '-')} is {value:g}; {least:g} to {most:g} {unit} is "
            f"allowed{hint}"
        )


def board_entry(text: str) -> dict[str, Any]:
    """Kind, columns, rows and, where it is given, pitch of a board, as keys of its entry.

    Raises InputError when ``text`` is not ``kind:COLUMNSxROWS[:pitch_mm]``.
    """
    match = _BOARD.match(text)
    if match is None:
        raise InputError(
            f"board {text!r}; kind:COLUMNSxROWS[:pitch_mm] is allowed, such as chessboard:6x6:2.5 "
            "(kinds chessboard, charuco, dots)"
        )
    entry: dict[str, Any] = {"kind": match[1], "columns": int(match[2]), "rows": int(match[3])}
    if match[4] is not None:
        try:
            entry["pitch_mm"] = number(match[4])
        except ValueError as error:
            raise InputError(f"board {text!r}: the pitch: {error}") from None
    return entry


@dataclass
class Draft:
    """A manifest, the files it names, what had to be assumed, and what was left out."""

    part: str
    """Name of the folder below the target when the source holds several sensors or sets."""
    sensor: str
    place: Path
    """Folder or file that it is read from."""
    root: Path | None = None
    """Folder that the person named, which messages name files below; ``place`` when None."""
    source: str = UNKNOWN
    license: str = UNKNOWN
    manifest: dict[str, Any] = field(default_factory=dict)
    files: dict[str, Image | str] = field(default_factory=dict)
    """Files by name in the folder: an image or any other file, RGB levels, or text."""
    notes: list[str] = field(default_factory=list)
    """What a person should know besides; kept as comments in the manifest."""
    assumed: dict[str, str] = field(default_factory=dict)
    """What no file says, by the name of the value: what was taken, and why."""
    used: set[Path] = field(default_factory=set)
    """Files that were taken in, or that something was read from."""
    left_out: dict[Path, str] = field(default_factory=dict)
    """Files that were not, each with the reason."""

    def assume(self, name: str, text: str) -> None:
        """Keep that the value ``name`` is stated by no file: what was taken, and why."""
        self.assumed[name] = text

    def assume_sensor(self, why: str = ANY_FLAT_GEL) -> None:
        """Keep that no file names the sensor."""
        self.assume("sensor", f"{self.sensor}, {why}")

    def leave_out(self, path: Path, why: str) -> None:
        """Keep why a file is not imported."""
        self.used.discard(path)
        self.left_out[path] = why

    def add_image(self, image: Image, name: str | None = None) -> str:
        """Take an image in; returns its name in the folder, made different where it is taken."""
        if isinstance(image, Path):
            stem = name or image.stem
            suffix = image.suffix.lower()
            suffix = suffix if suffix in COPIED_SUFFIXES else ".png"
        else:
            stem, suffix = name or "image", ".png"
        return self._add(image, stem, suffix)

    def add_file(self, path: Path, root: Path) -> str:
        """Take any other file in under its path below ``root``, folders joined by "_"; returns its
        name in the folder, made different where it is taken."""
        name = Path("_".join(path.relative_to(root).parts))
        return self._add(path, name.stem, name.suffix)

    def add_text(self, text: str, name: str) -> str:
        """Take a text file in; returns its name, as ``add_file``."""
        return self._add(text, Path(name).stem, Path(name).suffix)

    def _add(self, content: Image | str, stem: str, suffix: str) -> str:
        try:
            length = len((stem + suffix).encode())
        except UnicodeEncodeError:
            raise InputError(
                f"{self.place}: the file name {printable(stem + suffix)} is not UTF-8; rename it"
            ) from None
        if length > _NAME_BYTES:
            raise InputError(f"{self.place}: the file name {stem[:40]}... is too long; rename it")
        chosen, count = f"{stem}{suffix}", 1
        while chosen in self.files:
            count += 1
            chosen = f"{stem}_{count}{suffix}"
        self.files[chosen] = content
        if isinstance(content, Path):
            self.used.add(content)
        return chosen

    def set_background(self, image: Image, why: str | None = None) -> None:
        """Make ``image`` the background; ``why``, where nobody has stated that it is."""
        old = self.manifest.get("background")
        if old is not None and isinstance(replaced := self.files.pop(old), Path):
            self.leave_out(replaced, "--background replaces it")
        self.manifest["background"] = self.add_image(image, "background")
        self.assumed.pop("background", None)
        if why is not None:
            self.assume("background", why)

    def find_background(
        self, options: ImportOptions, *patterns: str, why: str = "by its name"
    ) -> Path | None:
        """Make the first image below ``place`` that a pattern matches the background, else one that
        is called so; a note where there is none."""
        found = images_in(self.place, *patterns) or [
            image for image in images_in(self.place) if BACKGROUND_NAME.search(image.stem)
        ]
        if found:
            self.set_background(found[0], f"{found[0].relative_to(self.place)}, {why}")
            return found[0]
        if options.background is None:
            self.notes.append(
                f"no background: {patterns[0].replace('*', 'png')} is missing; give one with "
                "--background, or --background median for that of the presses"
            )
        return None

    def add_untouched(self, image: Path) -> None:
        """Add a further background, unless it is the same image again."""
        background = self.files[self.manifest["background"]]
        assert isinstance(background, Path)
        if file_sha256(background) == file_sha256(image):
            self.leave_out(image, "the same image as the background")
        elif read_image(background).shape != read_image(image).shape:
            self.leave_out(image, "not of the background's size")
        else:
            self.manifest.setdefault("untouched", []).append(self.add_image(image, "untouched"))

    def add_presses(
        self,
        images: Sequence[Path],
        name: Callable[[Path], str] = lambda image: image.stem,
        stated: Sequence[dict[str, Any]] = (),
    ) -> None:
        """Add ball presses, with circles of the tables beside them; ``stated`` are further keys of
        the entry of each."""
        if not images:
            return
        labels = read_label_tables(self.place)
        circles = labels.of_images(images)
        for image, values in zip(images, stated or [{}] * len(images), strict=True):
            self.add_press(image, name(image), contact=circles.get(image), **values)
        self.tell_labels(labels, images)

    def tell_labels(self, labels: LabelTables, images: Sequence[Path]) -> None:
        """Keep which tables were read, and what of them has no effect on these presses."""
        self.used |= labels.read
        for path, why in labels.left_out.items():
            if path not in self.used:
                self.leave_out(path, why)
        if lost := labels.lost(images):
            shown = ", ".join(lost[:5]) + (f" and {len(lost) - 5} more" if len(lost) > 5 else "")
            self.notes.append(f"circles without an image here, or of no press: {shown}; {NAMES}")

    def add_press(self, image: Path | np.ndarray, name: str | None = None, **values: Any) -> None:
        """Add a ball press; ``values`` are further keys of its entry, None left out."""
        entry = {"image": self.add_image(image, name)}
        entry |= {key: value for key, value in values.items() if value is not None}
        self.manifest.setdefault("presses", []).append(entry)

    def set_ball(self, radius_mm: float, why: str | None = None) -> None:
        """State the ball's radius; ``why``, where no file here does."""
        self.manifest["indenter"] = {"kind": "sphere", "radius_mm": float(radius_mm)}
        self.assumed.pop("radius_mm", None)
        if why is not None:
            self.assume("radius_mm", f"{radius_mm:g} mm, {why}")

    def set_scale(
        self, mm_per_px_x: float, mm_per_px_y: float | None = None, why: str | None = None
    ) -> None:
        """State the scale; ``why``, where no file here does."""
        self.manifest["mm_per_px_x"] = float(mm_per_px_x)
        self.manifest["mm_per_px_y"] = float(mm_per_px_x if mm_per_px_y is None else mm_per_px_y)
        self.assumed.pop("mm_per_px", None)
        if why is not None:
            self.assume("mm_per_px", f"{mm_per_px_x:g} mm/px, {why}")

    def apply(self, options: ImportOptions, root: Path) -> None:
        """Let what a person states replace what the layout says."""
        if options.sensor is not None:
            self.sensor = sensor_family(options.sensor).name
            self.assumed.pop("sensor", None)
        family = known_sensor(self.sensor)
        if family is not None and profile_folder(self.sensor) is None:
            thickness = getattr(family.parameters(), "thickness_mm", None)
            thick = "" if thickness is None else f", {thickness:g} mm thick"
            self.assume(
                "gel", f"that of the catalogue's {self.sensor}{thick}: no file describes it"
            )
        if options.unit is not None:
            self.manifest["unit"] = options.unit
        if options.radius_mm is not None:
            self.set_ball(options.radius_mm)
        if options.mm_per_px_y is not None and options.mm_per_px_x is None:
            raise InputError("mm-per-px-y was given without mm-per-px-x; give both, or x for both")
        if options.mm_per_px_x is not None:
            self.set_scale(options.mm_per_px_x, options.mm_per_px_y)
        if options.edge_mm is not None:
            for edge in self.manifest.get("edges", []):
                edge["length_mm"] = options.edge_mm
            self.assumed.pop("edge_mm", None)
        if options.background == MEDIAN:
            self.set_background(self.median_of_presses(), "the median of the presses")
        elif options.background is not None:
            path = Path(options.background)
            path = path if path.is_file() else root / path
            if not path.is_file():
                raise InputError(f"{options.background}: no such background image")
            self._drop_press(path)
            self.set_background(path)
        if options.scale == "catalogue" and "mm_per_px_x" not in self.manifest:
            self._take_catalogue_scale()

    def _take_catalogue_scale(self) -> None:
        """Take the scale of the sensor's usual view, noted as assumed.

        Raises InputError where nobody states the sensor, and for images of other proportions.
        """
        if "sensor" in self.assumed:
            raise InputError(
                "--scale catalogue needs the sensor, which no file states: name it with --sensor"
            )
        names = [
            self.manifest.get("background"),
            *(e["image"] for e in self.manifest.get("presses", [])),
        ]
        name = next((name for name in names if name is not None), None)
        if name is None:
            raise InputError(f"--scale catalogue: {self.place} holds no image of the gel")
        height, width = levels(self.files[name]).shape[:2]
        x, y = catalogue_scale(self.sensor, width, height)
        self.set_scale(x, y, USUAL.format(self.sensor))

    def _drop_press(self, image: Path) -> None:
        """Take a press out whose image turns out to be something else."""
        presses = self.manifest.get("presses", [])
        for press in presses:
            content = self.files[press["image"]]
            if isinstance(content, Path) and content.samefile(image):
                presses.remove(press)
                del self.files[press["image"]]
                self.used.discard(content)
                return

    def median_of_presses(self) -> np.ndarray:
        """Median of the presses, RGB uint8: the untouched gel where presses are spread enough."""
        names = [entry["image"] for entry in self.manifest.get("presses", [])]
        if len(names) < 3:
            raise InputError(
                f"{self.place}: the median of {len(names)} presses is no background; at least 3"
            )
        return median_image([self.files[name] for name in names])

    def write(self, folder: Path) -> None:
        """Write files and manifest into ``folder``, which exists."""
        for name, content in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, str):
                path.write_text(content, encoding="utf-8")
            elif not isinstance(content, Path):
                write_image(path, levels(content))
            elif is_picture(content) and path.suffix == ".png" != content.suffix.lower():
                write_image(path, read_image(content))
            else:
                # Before gigabytes are copied that no reader takes.
                image = is_picture(content)
                limit = (MAX_FILE_BYTES, "an image") if image else (LARGEST_BYTES, "a capture")
                shutil.copyfile(require_regular_file(content, *limit), path)
        (folder / MANIFEST_NAME).write_text(self._manifest_text(), encoding="utf-8")

    def _manifest_text(self) -> str:
        manifest = {
            "schema_version": SCHEMA_VERSION,
            "sensor": self.sensor,
            **self.manifest,
            "source": self.source,
            "license": self.license,
        }
        if self.assumed:
            manifest["assumed"] = self.assumed
        return manifest_text(manifest, self.remarks())

    def _not_stated(self) -> list[str]:
        """What ball presses cannot be calibrated with before it is stated, with the options."""
        if not self.manifest.get("presses"):
            return []
        missing = []
        if self.sensor == "flat_pad" and "sensor" in self.assumed:
            missing.append("the sensor (--sensor; taccel-lab sensors list)")
        entries = self.manifest["presses"]
        if "indenter" not in self.manifest and not all("radius_mm" in e for e in entries):
            missing.append("the ball's radius (--radius-mm)")
        if "mm_per_px_x" not in self.manifest and not ({"boards", "edges"} & self.manifest.keys()):
            missing.append("the scale (--mm-per-px-x, or --scale catalogue for the usual one)")
        return missing

    def remarks(self) -> list[str]:
        """The notes, and what was left out with the reasons."""
        root = self.root or self.place
        missing = self._not_stated()
        unstated = [f"not stated yet, and needed: {'; '.join(missing)}"] if missing else []
        return [*self.notes, *unstated, *left_out_sentences(self.left_out, root)]

    @contextmanager
    def opened(self) -> Iterator[CaptureFolder]:
        """The captures without writing them anywhere that stays."""
        with tempfile.TemporaryDirectory(prefix="taccel_lab_") as name:
            self.write(Path(name))
            try:
                folder = load_capture_folder(Path(name))
            except InputError as error:
                raise InputError(str(error).replace(name, str(self.place))) from error
            yield replace(folder, source=str(self.place))


@dataclass(frozen=True)
class CaptureLayout:
    """One way in which people store captures."""

    name: str
    """Name on the command line."""
    title: str
    """One line: whose layout, and what tells it."""
    recognises: Callable[[Path], bool]
    """Whether a file or folder follows it; decodes a few images at most."""
    read: Callable[[Path, ImportOptions], list[Draft]]
    """One draft for each sensor or set; none where it is of another layout, which may be looked for
    less closely than by ``recognises``. Raises InputError naming the file, what was found and what
    is allowed."""
