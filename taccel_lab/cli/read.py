# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab depth``, ``force`` and ``read``: tactile images or a recording in; heights, forces
and markers out. One image that is rejected stops no other."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from taccel_lab.reading.reading import Reading
    from taccel_lab.signals.force_model import ForceReading


@dataclass(frozen=True)
class Read:
    """Read a recording frame by frame: a video, images, UniVTAC's HDF5 or a LeRobot data set.

    Every frame gives depth, contact area, normal force with its 95 % interval (contact of an
    elastic layer) and marker displacements, as far as the profile's blocks allow. Writes
    `readings.csv`, `readings.json` and curves over the frames, `readings.png`. Frames that cannot
    be read are rows with the reason. After an interrupt the same command goes on where it stopped.
    """

    profile: Positional[str]
    """Profile folder of this sensor, or a sensor of the catalogue with a starter profile."""
    source: Positional[Path]
    """A video, a folder of images in natural order, such as those of a rosbag, one image, an HDF5
    file of UniVTAC, or the folder of a LeRobot data set (v2, v3)."""
    out: Path
    """Folder to write."""
    camera: str | None = None
    """Camera of a data set that has several, by its name or the end of it: left_tactile/rgb."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's. With a starter profile it is
    looked for: background.png beside the source, or the still frames of the recording."""
    fps: float | None = None
    """Frames a second, in place of the times that the source tells: a video's own, a LeRobot data
    set's, stamps in the names of images. A gel that relaxes is followed by them. Without any, the
    intervals of its forces reach from a long press to a sudden one."""
    json: bool = False
    """Print the rows as JSON."""

    def run(self) -> None:
        import numpy as np

        from taccel_lab.calibration.capture.camera.recording import Recording
        from taccel_lab.calibration.live.reader import LiveReader
        from taccel_lab.calibration.live.recorded import read_recorded, remarks_of
        from taccel_lab.calibration.untouched_frame import UntouchedFrame
        from taccel_lab.cli.console import notes, print_json, results
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.files.regular_file import file_sha256
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.sensors.profile import profile_folder, stock_sensor
        from taccel_lab.version import __version__

        start_warp()
        require_replaceable(self.out)
        profile, own = stock_sensor(self.profile), profile_folder(self.profile)
        recording = Recording.of(self.source, self.camera, self.fps)
        found = UntouchedFrame.of(profile, [self.source], self.background, camera=self.camera)
        profile = found.profile
        untouched = profile.untouched(found.image, found.name).astype(np.float32)
        reader = LiveReader(profile, untouched)
        recipe = {
            "version": __version__,
            "profile": self.profile if own is None else file_sha256(own / "profile.toml"),
            "source": [str(self.source), recording.camera, recording.names],
            "background": hashlib.sha256(untouched.tobytes()).hexdigest(),
            "fps": self.fps,
        }
        console = notes()

        def bar(task: str, done: int, total: int) -> None:
            if done % 50 == 0 or done == total:
                console.print(f"{task}: {done} of {total}")

        rows = read_recorded(recording, reader, self.out, recipe, bar)
        if self.json:
            print_json({"out": str(self.out), "frames": rows})
            return
        forces = [row["force_n"] for row in rows if row.get("force_n") is not None]
        depths = [row["depth_mm"] for row in rows if row.get("depth_mm") is not None]
        refused = sum(bool(row["refused"]) for row in rows)
        said = f"{len(rows)} frames, {refused} refused"
        said += f", up to {max(depths):.3f} mm" if depths else ""
        said += f" and {max(forces):.3g} N" if forces else ""
        if any(row["time_s"] is not None for row in rows):
            said += f"; times: {recording.times_from}"
        for remark, count in remarks_of(rows):
            of = "" if count == len(rows) - refused else f" ({count} frames)"
            results().print(f"  {remark}{of}", soft_wrap=True)
        results().print(f"{said}\nwrote {self.out}", soft_wrap=True)


Found = TypeVar("Found")
"""What a command reads from one image."""


def require_images(paths: Sequence[Path]) -> None:
    """Refuse images that are not there, and such that would overwrite each other's files."""
    if not paths:
        raise InputError("no image was given; name at least one PNG or JPEG")
    for path in paths:
        if path.is_dir():
            raise InputError(
                f"{path} is a folder; name its images, as {path}/*.png does, or take taccel-lab "
                "read, which reads a folder frame by frame"
            )
        if not path.is_file():
            raise InputError(f"{path} does not exist or is no file; an image is needed")
    stems = [path.stem for path in paths]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice:
        raise InputError(
            f"images named alike would overwrite each other's files: {', '.join(twice)}"
        )


def each_image(
    paths: Sequence[Path],
    out: Path | None,
    read: Callable[[Path], Found],
    keep: Callable[[Found, Path, Path | None], dict[str, Any]],
    *,
    title: str,
    as_json: bool,
    lines: Callable[[Path, dict[str, Any]], Sequence[str]],
) -> dict[str, dict[str, Any]]:
    """Read images, write what they show and tell it; returns figures by name of the image.

    Args:
        paths: The images.
        out: Folder to write, or None.
        read: Gives what an image shows; an InputError refuses that image alone.
        keep: Writes it into the folder that is given, where there is one; returns its figures.
        title: Of the page that the folder gets.
        as_json: Print all figures and refusals as JSON at the end, not lines as they come.
        lines: What to print of an image.

    Raises:
        InputError: With the reasons, when images were rejected; after the others' files are written
            and told. Where none could be read, nothing is written.
    """
    from taccel_lab.cli.console import print_json, results
    from taccel_lab.files.output_folder import atomic_directory
    from taccel_lab.report.page import PAGE, write_page_file
    from taccel_lab.report.readings_page import readings_page

    console, figures = results(), {}
    refused: dict[str, str] = {}
    said: dict[str, Sequence[str]] = {}
    with nullcontext() if out is None else atomic_directory(out) as folder:
        for path in paths:
            try:
                found = read(path)
            except InputError as error:
                refused[path.stem] = str(error)
                continue
            figures[path.stem] = about = keep(found, path, folder)
            said[path.stem] = lines(path, about)
            for line in () if as_json else said[path.stem]:
                console.print(line, soft_wrap=True)
        if not figures:
            # Leaving with an error keeps what an earlier run wrote there.
            if as_json:
                print_json({"out": None, "images": {}, "refused": refused})
            raise InputError("\n".join(refused.values()))
        if folder is not None:
            write_page_file(readings_page(title, said, refused, folder), folder / PAGE)
    if as_json:
        folder = None if out is None else str(out)
        print_json({"out": folder, "images": figures, "refused": refused})
    elif out is not None:
        console.print(f"wrote {out}", soft_wrap=True)
    if refused:
        raise InputError("\n".join(refused.values()))
    return figures


@dataclass(frozen=True)
class Depth:
    """Read height maps, pressures and forces from tactile images with a calibrated profile.

    A normals block (colour sensors) gives normals, which are integrated; a depth_response block
    (grey sensors) gives depths. For every image, `<name>.npz` holds depth, height, their standard
    deviation and the pressure, `<name>.png` shows them, and `<name>.json` has depth, position, area
    and force with its 95 % interval, from the contact of an elastic layer. Depths (`depth_m`, in
    metres) count from where the gel rests: positive in a dent, zero within their interval on an
    untouched gel, curved or flat. Heights (`height_m`) are z in the gel frame and keep the gel's
    curve. The +- is one standard deviation of the absolute depth, calibration included. The light
    of each image is brought to the profile's, and an untouched gel reads as no contact, 0 N. Images
    that cannot be a press of this sensor are listed with the reason. The others are still read, and
    the exit code is 2.
    """

    profile: Positional[str]
    """Profile folder, from `taccel-lab calibrate normals` or `calibrate depth`, or a sensor of the
    catalogue with a starter profile, which needs an untouched image."""
    images: Positional[tuple[Path, ...]]
    """Tactile images (PNG or JPEG) of the profile's size, or raw ones with --maps."""
    out: Path
    """Folder to write: a page of all, three files per image."""
    ply: bool = False
    """Also write the surface as `<name>.ply`: vertices in metres with their normals, triangles."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's. With a starter profile it is
    looked for beside the images: background.png, or the still frames of a recording."""
    mask: Path | None = None
    """Grey image; pixels of value 0 are not read, and the surface spans them smoothly."""
    maps: Path | None = None
    """Rectification maps (.npz) of `taccel-lab calibrate camera --maps`, for raw images."""
    method: Literal["auto", "normals", "depth"] = "auto"
    """Model to read with. auto: normals, if the profile has both."""
    json: bool = False
    """Print the figures as JSON instead of a line per image."""

    def run(self) -> None:
        from taccel_lab.calibration.camera.rectification import RectificationMaps
        from taccel_lab.calibration.untouched_frame import UntouchedFrame
        from taccel_lab.files.images import image_size, read_image
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.reading.mask_file import read_mask
        from taccel_lab.reading.reader import Reader
        from taccel_lab.sensors.profile import stock_sensor

        start_warp()
        require_replaceable(self.out)
        require_images(self.images)
        profile = stock_sensor(self.profile)
        maps = None if self.maps is None else RectificationMaps.load(self.maps)

        def rectified(image: np.ndarray, name: str) -> np.ndarray:
            if maps is None:
                return image
            maps.require_raw_size((image.shape[1], image.shape[0]), name)
            return maps.apply(image)

        mask = None if self.mask is None else read_mask(self.mask, profile)
        if maps is not None:
            width, height = maps.raw_size_px or image_size(self.images[0])
            # What the raw image does not show is black in the rectified one, not a dent.
            shown = maps.inside((height, width))
            camera = profile.camera.width_px, profile.camera.height_px
            if shown.shape != camera[::-1]:
                raise InputError(
                    f"{self.maps} makes images of {shown.shape[1]}x{shown.shape[0]} px, the "
                    f"profile's camera has {camera[0]}x{camera[1]} px; give the maps of the "
                    "profile's calibration"
                )
            mask = shown if mask is None else mask & shown
        untouched = UntouchedFrame.of(profile, self.images, self.background, fit=rectified)
        reader = Reader(
            untouched.profile,
            background=untouched.image,
            mask=mask,
            background_name=untouched.name,
            method=self.method,
        )

        def read(path: Path) -> Reading:
            return reader.read(rectified(read_image(path), str(path)), str(path))

        def keep(found: Reading, _: Path, folder: Path | None) -> dict[str, Any]:
            assert folder is not None
            return found.write_into(folder, ply=self.ply)

        each_image(
            self.images, self.out, read, keep,
            title="Depths read from images", as_json=self.json, lines=_depth_lines,
        )  # fmt: skip


def _depth_lines(path: Path, about: dict[str, Any]) -> list[str]:
    depth, *pressed = about["words"]
    notes = (*pressed, *about["warnings"], *about["force_remarks"])
    return [f"{path.name}: {depth}", *(f"  {text}" for text in notes)]


@dataclass(frozen=True)
class Force:
    """Read forces from tactile images with a profile that has a force model.

    Reads force and moment on the object in the gel frame (a press is +z), contact area and its
    middle, and the force by patch of the image, with standard deviations. With --out, `<name>.png`
    shows the patches of each image and `<name>.json` holds all of it. Images unlike the training
    (another sensor, deeper presses) are marked, and the exit code is 1. Images that cannot be read,
    or have another size, are listed with the reason. The others are still read, and the exit code
    is 2.
    """

    profile: Positional[Path]
    """Profile folder, from `taccel-lab calibrate force`."""
    images: Positional[tuple[Path, ...]]
    """Tactile images (PNG or JPEG) of the profile's size."""
    out: Path | None = None
    """Folder to write: a page of all, two files per image. Default: none."""
    background: Path | None = None
    """Image of the untouched sensor, if newer than the profile's, or of another unit."""
    json: bool = False
    """Print the figures as JSON instead of lines per image."""

    def run(self) -> None:
        from taccel_lab.files.images import read_image
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.learning.force.read_force import ForceReader, write_force
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile

        start_warp()
        if self.out is not None:
            require_replaceable(self.out)
        require_images(self.images)
        reader = ForceReader(
            load_profile(self.profile),
            background=None if self.background is None else read_image(self.background),
            background_name=str(self.background or "the background"),
            profile_name=str(self.profile),
        )

        def read(path: Path) -> tuple[ForceReading, np.ndarray]:
            image = read_image(path)
            return reader.read(image, str(path)), image

        def keep(
            found: tuple[ForceReading, np.ndarray], path: Path, folder: Path | None
        ) -> dict[str, Any]:
            if folder is not None:
                return write_force(*found, path, folder)
            return {"image": str(path), **found[0].figures()}

        figures = each_image(
            self.images, self.out, read, keep,
            title="Forces read from images", as_json=self.json, lines=_force_lines,
        )  # fmt: skip
        if not all(about["inside_training"] for about in figures.values()):
            raise SystemExit(1)


def _force_lines(path: Path, about: dict[str, Any]) -> list[str]:
    def components(letter: str, values: list[float], sigmas: list[float], unit: str) -> str:
        return ", ".join(
            f"{letter}{axis} {value:.3f} +- {sigma:.3f} {unit}"
            for axis, value, sigma in zip("xyz", values, sigmas, strict=True)
        )

    lines = [
        f"{path.name}: {components('F', about['force_n'], about['force_sigma_n'], 'N')}",
        f"  {components('T', about['moment_nmm'], about['moment_sigma_nmm'], 'N mm')}",
    ]
    area = f"  area {about['area_mm2']:.2f} +- {about['area_sigma_mm2']:.2f} mm2"
    if about["center_mm"] is None:
        area += "; no touch is detected"
    else:
        area += ", middle at ({:.2f}, {:.2f}) mm".format(*about["center_mm"])
    return [*lines, area, *(f"  outside the training: {reason}" for reason in about["outside"])]
