# SPDX-License-Identifier: Apache-2.0
"""Captures of a gel with dots in, the profile's ``markers`` block and the dots' tracks out."""

from __future__ import annotations

from itertools import islice

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.captures import Frame
from taccel_lab.calibration.capture.folder import Video
from taccel_lab.calibration.capture.load import cut_short
from taccel_lab.calibration.markers.gel_view import PixelView, choose_view, pixel_jacobian
from taccel_lab.calibration.markers.remarks import GRID_BENT, VIDEO_CUT_SHORT, WEAK_CONTRAST
from taccel_lab.calibration.markers.rest import MarkerRest, find_rest, frames_before, video_name
from taccel_lab.calibration.markers.result import MarkerCalibration, TrackedVideo
from taccel_lab.calibration.markers.tracking import track_markers
from taccel_lab.calibration.markers.tracks import MarkerTracks, track_figures
from taccel_lab.errors import InputError, naming
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.dots.detection import Dots
from taccel_lab.reading.dots.lattice import LayoutFit, fit_layout, renumbered
from taccel_lab.reading.dots.marker_picture import MarkerPicture, find_markers
from taccel_lab.report.remark import Remark
from taccel_lab.robust_fit import spread_about_median

_BENT = 0.05
"""RMS residual of the grid, in pitches, above which it is worth a remark."""
_WEAK_CONTRAST = 0.12


def calibrate_markers(
    folder: CaptureFolder, base: SensorProfile, progress: Progress = silent
) -> MarkerCalibration:
    """Find the dots at rest, fit their layout on the gel, and follow them through the videos.

    Args:
        folder: Captures; the picture at rest is the markers' own, or else the background, or else
            a frame in which a video rests.
        base: Profile of the sensor, for what pixels look at.

    Raises:
        InputError: No picture, none at rest, no dots on a lattice, or frames of another size.
    """
    markers = folder.markers
    progress("finding the dots", 0, 1)
    found = MarkerRest(folder.require_background()) if markers is None else find_rest(markers)
    rest = found.frame
    image = rest.image()
    with naming(rest.source):
        picture = find_markers(image)
    progress("finding the dots", 1, 1)
    height, width = image.shape[:2]
    view, scale_remarks = choose_view(folder, base, picture.layout_px, (width, height))
    layout_mm = layout_on_gel(picture, view)
    radius_mm, radius_sigma = _radius_mm(picture.dots, view)
    videos = tuple(
        _follow(video, start, picture, progress)
        for video, start in zip(
            () if markers is None else markers.videos, found.starts, strict=True
        )
    )
    remarks = (
        *found.remarks,
        *_layout_remarks(picture, layout_mm),
        *scale_remarks,
        *(remark for video in videos for remark in video.figures.remarks()),
        *(
            VIDEO_CUT_SHORT(reason=fault)
            for video in videos
            if (fault := cut_short(video.video)) is not None
        ),
    )
    return MarkerCalibration(
        source=rest.source,
        image=image,
        picture=picture,
        layout_mm=layout_mm,
        radius_mm=min(radius_mm, 0.5 * min(layout_mm.pitch)),
        radius_sigma_mm=radius_sigma,
        view=view,
        videos=videos,
        remarks=remarks,
        inputs=_inputs(folder, rest, videos),
    )


def layout_on_gel(picture: MarkerPicture, view: PixelView) -> LayoutFit:
    """The grid in gel millimetres: the dots through the view, fitted again.

    Raises:
        InputError: Too few of the dots lie where the view sees the gel.
    """
    dots, lattice = picture.dots, picture.lattice
    points = view.gel_from_pixel(dots.uv_px)
    jacobian = pixel_jacobian(view, dots.uv_px)
    on_gel = np.asarray(np.isfinite(np.column_stack([points, jacobian.reshape(-1, 4)])).all(axis=1))
    covariance = np.einsum("nij,njk,nlk->nil", jacobian, dots.covariance_px2, jacobian)
    missing = np.zeros((lattice.rows, lattice.columns), dtype=bool)
    if picture.layout_px.missing:
        missing[tuple(np.transpose(picture.layout_px.missing))] = True
    lattice, (first_row, first_column) = renumbered(lattice, on_gel)
    missing = missing[first_row:, first_column:][: lattice.rows, : lattice.columns]
    safe = np.where(on_gel[:, None], points, 0.0)
    covariance = np.where(on_gel[:, None, None], covariance, np.eye(2))
    return fit_layout(safe, lattice, covariance=covariance, in_view=missing)


def _radius_mm(dots: Dots, view: PixelView) -> tuple[float, float]:
    """Median radius of whole dots on the gel, and its standard deviation [mm]."""
    whole = dots.whole if dots.whole.sum() >= 3 else np.ones(dots.count, dtype=bool)
    jacobian = pixel_jacobian(view, dots.uv_px[whole])
    scale = np.sqrt(np.abs(np.linalg.det(jacobian)))
    radius = dots.radius_px[whole] * scale
    radius = radius[np.isfinite(radius)]
    if len(radius) == 0:
        raise InputError("no whole dot lies where the camera sees the gel")
    spread = spread_about_median(radius)
    return float(np.median(radius)), 1.2533 * spread / np.sqrt(len(radius))


def _follow(video: Video, start: int, picture: MarkerPicture, progress: Progress) -> TrackedVideo:
    """Tracks from a frame near rest to the end, and back to the beginning."""
    name, onward = video_name(video), islice(video.frames(), start, None)
    count = video.frame_count
    with naming(video.source):
        tracks = track_markers(counted(onward, progress, name, count - start), picture)
        if start > 0:
            before = counted(frames_before(video, start), progress, name, start + 1)
            tracks = MarkerTracks.joined(track_markers(before, picture), tracks)
    return TrackedVideo(name, video, tracks, track_figures(name, tracks, start))


def _inputs(folder: CaptureFolder, rest: Frame, videos: tuple[TrackedVideo, ...]) -> dict[str, str]:
    inputs = {rest.source.replace("\\", "/").split("/")[-1]: rest.sha256}
    for video in videos:
        inputs[video.name] = video.video.sha256
    if "manifest_sha256" in folder.provenance:
        inputs["captures.toml"] = folder.provenance["manifest_sha256"]
    return inputs


def _layout_remarks(picture: MarkerPicture, layout_mm: LayoutFit) -> list[Remark]:
    said = []
    contrast = float(np.median(np.abs(picture.dots.contrast)))
    if contrast < _WEAK_CONTRAST:
        said.append(WEAK_CONTRAST(percent=100 * contrast))
    bent = layout_mm.residual_rms / min(layout_mm.pitch)
    if bent > _BENT:
        said.append(GRID_BENT(residual_mm=layout_mm.residual_rms, percent=100 * bent))
    return said
