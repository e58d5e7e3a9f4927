# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate NAME``: a command for each row of ``taccel_lab.calibration.blocks``, which
fits it and shows it; forces from simulated touches, and a profile brought to the light of today.
Here stands what the command line adds: help and options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.calibration.press_options import ColorOptions, DepthOptions, NormalOptions
from taccel_lab.cli.calibration_outputs import (
    BlockCommand,
    report_folder,
    require_outputs,
    write_results,
)
from taccel_lab.errors import InputError
from taccel_lab.learning.force.options import ForceOptions

if TYPE_CHECKING:
    from taccel_lab.calibration.background.fit import BackgroundOptions
    from taccel_lab.calibration.material.options import MaterialOptions
    from taccel_lab.profile import SensorProfile

Files = Mapping[Path, Callable[[Path], None]]


@dataclass(frozen=True)
class CalibrateBackground(BlockCommand):
    """Average all frames to a quieter background, the drift of each frame's light taken off.

    Uses the background, the further untouched images and the untouched parts of the presses; with
    no untouched image at all, the median of five or more presses. Reports the drift over the
    frames, whether the white balance was automatic, the noise of the pixels, and dust. Writes the
    block ``background``, and dust.png beside the report, which serves as the captures' mask; of
    several frames the block ``perturbation``, too, from which
    taccel_lab.signals.perturbation.draw_perturbation draws sensors.
    """

    units: tuple[Path, ...] = ()
    """Profiles of other units of the same design, whose images at rest, scales and materials are
    compared, too; the base counts as one when it is given."""

    def options(self, base: SensorProfile) -> BackgroundOptions:
        from taccel_lab.calibration.background.fit import BackgroundOptions
        from taccel_lab.profile import load_profile

        units = [load_profile(path) for path in self.units]
        if units and self.base is not None:
            units.insert(0, base)
        return BackgroundOptions(tuple(units))


@dataclass(frozen=True)
class CalibrateCamera(BlockCommand, CameraOptions):
    """Fit the camera to views of a calibration board and write a profile.

    Boards held before the camera give the lens (optics block); boards that lie on the gel or are
    pressed into it give mm/px in x and y and the pose of the gel (camera block). Chessboards,
    ChArUco boards, boards of dots and of pins are found, also where points are missing.
    """

    captures: Positional[Path]
    """Capture folder whose captures.toml names [[boards]] (docs/calibration_camera.md)."""
    maps: Path | None = None
    """File (.npz) for rectification maps: map_u_px and map_v_px for cv2.remap, the pixels that the
    board measured, and the grid's scale."""

    def check(self) -> None:
        """Refuse a file of maps that cannot be written."""
        if self.maps is not None and (self.maps.suffix != ".npz" or self.maps.is_dir()):
            raise InputError(f"--maps writes one .npz file, got {self.maps}")

    def files(self, result: Any) -> Files:
        return {} if self.maps is None else {self.maps: lambda path: result.maps().save(path)}


@dataclass(frozen=True)
class CalibrateColor(BlockCommand, ColorOptions):
    """Fit the pixel-to-colour model to captured ball presses and write a profile.

    Every press is simulated to get the gel's surface under it; the model then learns the colour
    of each pixel from position, normal and displacement. Figures are of presses that were chosen
    before any image was read, and are looked at when the model is frozen. Simulations are kept, so
    that a second run takes the fit only.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    base: Path | None = None
    """Profile to extend. Default: the catalogue's design of the sensor, turned as the images
    are. An unknown sensor becomes a flat pad."""


@dataclass(frozen=True)
class CalibrateDepth(BlockCommand, DepthOptions):
    """Fit the depth of a grey sensor (9DTact) to ball presses and write a profile.

    Such a gel looks darker where it is pressed. The ball's shape gives the depth of every pixel
    inside a contact. A monotone curve from grey level to depth is fitted, with its error on
    left-out presses, or parts of a single one. Rectify raw images of a distorting lens with --maps.
    `taccel-lab depth` then reads height maps.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md): background and [[presses]]."""
    base: Path | None = None
    """Profile to extend. Default: the catalogue's design of the sensor. Its camera gives the
    scale if the captures state none."""


@dataclass(frozen=True)
class CalibrateMarkers(BlockCommand):
    """Find the dots painted on the gel, fit their grid and follow them through videos.

    Dots may be dark or bright, of any size, in a square, rectangular or hexagonal grid, with some
    missing; nothing needs tuning. The picture at rest is [markers] rest in captures.toml, else the
    background, else still frames of [[markers.videos]]. Without any of these the command fails.
    """

    base: Path | None = None
    """Profile to extend. Default: the catalogue's design of the sensor. A profile with a
    calibrated camera or scale gives the millimetres."""
    tracks: Path | None = None
    """File for the dots' positions and displacements in every frame, pixels and millimetres:
    .npz or .csv."""

    def check(self) -> None:
        """Refuse a file of tracks of an unknown kind."""
        from taccel_lab.calibration.markers.tracks import require_track_file

        if self.tracks is not None:
            require_track_file(self.tracks)

    def files(self, result: Any) -> Files:
        from taccel_lab.calibration.markers.tracks import write_tracks

        tracks = {video.name: video.tracks for video in result.videos}
        if self.tracks is None:
            return {}
        return {self.tracks: lambda path: write_tracks(path, tracks, result.flows())}


@dataclass(frozen=True)
class CalibrateMaterial(BlockCommand):
    """Fit stiffness, Poisson's ratio and friction to force records and write a profile.

    Presses of the record's tool on the sensor's gel are simulated once and cached. The fit gives
    each parameter with its 95 % interval; the report names those that the records do not determine.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml whose [[records]] name force records (docs/captures.md)."""
    model: (
        Literal["neo_hookean", "stable_neo_hookean", "st_venant_kirchhoff", "mooney_rivlin"] | None
    ) = None
    """Material law of the gel. Default: the base profile's."""
    fix: tuple[str, ...] = ()
    """Parameters to hold, such as nu=0.48 or e=3e5: e [Pa], nu, mooney_ratio, friction."""
    touch_sigma_mm: float | None = None
    """Uncertainty of first touch in the records [mm]. Default: for few points 0.1 (ball) or 0.05
    (flat punch), for many 0.2. 0 trusts the records."""
    accuracy: Literal["fast", "default", "reference"] = "default"
    """Accuracy of the simulated presses, and of those that reproduce the records."""
    device: str = "cpu"
    """Device of the presses: cpu, or cuda:0."""

    def check(self) -> None:
        """Refuse an unknown device and parameters that cannot be held."""
        from taccel_lab.model.launches import require_device

        require_device(self.device)
        self.options()

    def options(self, base: SensorProfile | None = None) -> MaterialOptions:
        from taccel_lab.calibration.material.options import MaterialOptions
        from taccel_lab.presses.physics import PHYSICS, Accuracy

        return MaterialOptions(
            model=self.model,
            fixed=parse_fixed(self.fix),
            touch_sigma_mm=self.touch_sigma_mm,
            physics=PHYSICS[Accuracy(self.accuracy)],
            device=self.device,
        )


@dataclass(frozen=True)
class CalibrateNormals(BlockCommand, NormalOptions):
    """Fit the model from colour to surface normal to captured ball presses and write a profile.

    Inside a contact the ball gives the normal of every pixel; a small ensemble of networks learns
    it from the change of colour around the pixel, with its own uncertainty. Figures are of
    presses that were chosen before any image was read, and are looked at when the model is frozen.
    `taccel-lab depth` then reads height maps from images.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""


@dataclass(frozen=True)
class CalibrateScale(BlockCommand):
    """Measure mm/px along x and y from captures of known length.

    Boards on the gel, presses of a straight edge, markers of known pitch, and ball presses with
    depths each give a scale with its uncertainty. They are compared and, if they agree, averaged.
    Ball presses without depths give an upper limit only.
    """

    captures: Positional[Path]
    """Capture folder (docs/calibration_camera.md)."""


def parse_fixed(items: tuple[str, ...]) -> dict[str, float]:
    """Held parameters from ``name=value``; InputError says what is wrong."""
    fixed = {}
    for item in items:
        name, equals, value = item.partition("=")
        try:
            fixed[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--fix {item!r} is not understood; write name=value, as in nu=0.48")
    return fixed


@dataclass(frozen=True)
class CalibrateForce(ForceOptions):
    """Train the model from images to forces on a data set of simulated touches and write a profile.

    Make the data set (taccel-lab dataset) with the profile of your sensor and units drawn from its
    spread; it needs the channels rgb and patch_forces_n. Whole objects and units are held out
    before an image is read; the report has their errors by depth, shear and position. The training
    is saved every 10 s beside the new profile, and the same command continues it. `taccel-lab
    force` then reads images. Not part of calibrate all.
    """

    datasets: Positional[tuple[Path, ...]]
    """Folders of a data set, or of its shards."""
    out: Path
    """Profile folder to write."""
    profile: Path | None = None
    """Profile to extend. Default: the one of the data set."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON). Default: <out>_report."""
    tensorboard: Path | None = None
    """Folder for the loss as TensorBoard reads it; needs the extra tensorboard."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from taccel_lab.cli.console import notes, say
        from taccel_lab.datasets.reading import Dataset
        from taccel_lab.errors import keeping
        from taccel_lab.learning.force.fit import calibrate_force
        from taccel_lab.learning.force.force_page import force_page
        from taccel_lab.learning.force.training_file import TrainingFile
        from taccel_lab.learning.scalars import scalars_in
        from taccel_lab.processes.start_warp import start_warp
        from taccel_lab.profile import load_profile
        from taccel_lab.progress import stage_progress

        start_warp()
        if not self.datasets:
            raise InputError("name at least one folder of a data set")
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        base = (
            Dataset(self.datasets).profile(0)
            if self.profile is None
            else load_profile(self.profile)
        )
        kept = TrainingFile.beside(self.out, say)
        with keeping(kept.what_stays):
            with stage_progress(notes()) as progress, scalars_in(self.tensorboard) as scalars:
                result = calibrate_force(self.datasets, base, self, progress, kept, scalars)
            saved = result.apply_to(base), self.out
            write_results("force", result, force_page(result), saved, report, self.json)
        kept.remove()


@dataclass(frozen=True)
class CalibrateRefit:
    """Correct an existing profile for aged lamps or a changed camera, from about 5 new frames.

    Fits gain, offset and gradient of the background and the response of the colour model, by
    channel. Reports errors on left-out frames before and after. Rejects frames that do not
    determine the correction, and corrections that gain nothing. Of four presses or more a quarter
    is held out and scored. The model's last layer is scaled.
    """

    profile: Positional[Path]
    """Profile folder to correct, with a background and a colour model."""
    captures: Positional[Path]
    """Capture folder of today: 5 frames or more, at least 2 ball presses among them; the presses
    also need [indenter] radius_mm. The scale is the profile's."""
    out: Path
    """Profile folder to write."""
    report: Path | None = None
    """Folder for the report. Default: <out>_report."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.base_profile import with_session
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.refit.fit import calibrate_refit
        from taccel_lab.calibration.refit.result import refit_page
        from taccel_lab.cli.console import notes, working
        from taccel_lab.profile import load_profile

        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        profile = load_profile(self.profile)
        folder = load_capture_folder(self.captures)
        with working(notes(), "finding the presses and fitting the light"):
            result = calibrate_refit(folder, profile)
        fresh = with_session(profile, result.apply_to(profile), folder)
        page = refit_page(result, profile)
        write_results("refit", result, page, (fresh, self.out), report, self.json)


BLOCK_COMMANDS: dict[str, type[BlockCommand]] = {
    command.block_name(): command
    for command in (
        CalibrateBackground,
        CalibrateCamera,
        CalibrateColor,
        CalibrateDepth,
        CalibrateMarkers,
        CalibrateMaterial,
        CalibrateNormals,
        CalibrateScale,
    )
}
