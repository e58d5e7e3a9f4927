# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate NAME``: a command for each row of ``taccel_lab.calibration.blocks``, which
fits it and shows it. Here stands what the command line adds: help and options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.calibration.press_options import ColorOptions, DepthOptions, NormalOptions
from taccel_lab.cli.calibrate.base import BlockCommand
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.calibration.light.background import BackgroundOptions
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
        from taccel_lab.calibration.light.background import BackgroundOptions
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
