# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image from everything in a capture folder that has a known length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from taccel_lab.calibration.camera.blocks import tactile_size, with_camera_block
from taccel_lab.calibration.camera.stated_scale import stated_scale_remarks
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.result import Estimate, Remark, Severity, judge
from taccel_lab.calibration.scale.boards import scale_from_boards
from taccel_lab.calibration.scale.combine import CombinedAxis, agreement_remarks, combine_axis
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.scale.landmarks import scale_from_landmarks
from taccel_lab.calibration.scale.markers import scale_from_markers
from taccel_lab.calibration.scale.spheres import measure_contacts, scale_from_spheres
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, Provenance, SensorProfile

STATED = "stated"
STATED_ERROR = 0.05
"""Standard deviation of a scale that is stated and not measured, as a share."""
UNSURE_SHARE = 0.05
"""Relative standard deviation of a scale from which on it is called weak."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ScaleCalibration:
    """Scales by method, and what they give together."""

    source: str
    size_px: tuple[int, int]
    estimates: tuple[ScaleEstimate, ...]
    axes: dict[str, CombinedAxis]
    """``x`` and ``y``; an axis that nothing was measured along is missing."""
    failures: dict[str, str]
    """Methods whose captures are there but gave nothing, with the reason."""
    provenance: dict[str, str]
    remarks: tuple[Remark, ...]

    @property
    def scale(self) -> tuple[float, float]:
        """mm/px along x and y; InputError where only a limit is known."""
        if "x" not in self.axes and "y" not in self.axes:
            raise InputError(_only_limits(self.source, self.estimates))
        x = self.axes.get("x") or self.axes["y"]
        y = self.axes.get("y") or self.axes["x"]
        return x.estimate.value, y.estimate.value

    def inputs(self) -> dict[str, str]:
        """SHA-256 of the images used, by method and name."""
        return {
            f"{estimate.method}/{name}": value
            for estimate in self.estimates
            for name, value in estimate.inputs.items()
        }

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "methods": {estimate.method: estimate.figures() for estimate in self.estimates},
            "failed_methods": dict(self.failures),
            "combined": {
                axis: {
                    "value": found.estimate.value,
                    "sigma": found.estimate.sigma,
                    "interval95": list(found.estimate.interval95),
                    "chi_square": found.chi_square,
                    "freedom": found.freedom,
                    "probability": found.probability,
                    "agrees": found.agrees,
                    "pair_z": found.pairs,
                }
                for axis, found in self.axes.items()
            },
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with its pixel grid at the calibrated scale."""
        scale = self.scale
        camera = profile.camera
        size = tactile_size(profile, self.size_px) or self.size_px
        grid = PixelGrid(*size, *scale)
        if (camera.width_px, camera.height_px) == size:
            grid = replace(grid, center_u_px=camera.center_u_px, center_v_px=camera.center_v_px)
        spread, interval = {}, {}
        for axis, found in self.axes.items():
            spread[f"mm_per_px_{axis}"] = found.estimate.sigma
            interval[f"mm_per_px_{axis}"] = found.estimate.interval95
        methods = [estimate.method for estimate in self.estimates if estimate.x or estimate.y]
        residuals = {
            f"{estimate.method}_minus_mean_{axis}_mm_per_px": one.value - found.estimate.value
            for estimate in self.estimates
            for axis, found in self.axes.items()
            if (one := estimate.along(axis)) is not None
        }
        x_mm, y_mm = grid.x_mm(), grid.y_mm()
        block = CameraBlock.from_grid(
            grid,
            Provenance(
                kind="published" if STATED in methods else "calibrated",
                method=f"mm/px from {', '.join(methods)}, weighed by inverse variance; the gel "
                "frame's origin as before, else in the middle of the image",
                source=self.provenance.get("source", self.source),
                inputs=self.inputs(),
                residuals=residuals,
                spread=spread,
                interval=interval,
                valid_region={
                    "x_mm": (float(x_mm[0]), float(x_mm[-1])),
                    "y_mm": (float(y_mm[0]), float(y_mm[-1])),
                },
                verdict=judge(self.remarks).value,
                remarks=tuple(remark.message for remark in self.remarks),
            ),
        )
        return with_camera_block(profile, block)


def calibrate_scale(
    folder: CaptureFolder,
    profile: SensorProfile | None = None,
    *,
    progress: Progress | None = None,
) -> ScaleCalibration:
    """Scale from boards on the gel, pressed edges, markers, landmarks and ball presses.

    Args:
        folder: Whatever of these is in it is used.
        profile: The designed sensor: where its gel frame's origin is.

    Raises:
        InputError: Nothing with a known length, or nothing of it could be measured.
    """
    gel_boards = [board for board in folder.boards if board.entry.on_gel]
    jobs: list[tuple[str, Callable[[], ScaleEstimate]]] = []
    if gel_boards:
        jobs.append(("board", lambda: scale_from_boards(gel_boards)))
    if folder.edges:
        jobs.append(("edge", lambda: _from_edges(folder)))
    markers = folder.markers
    if markers is not None and (markers.pitch_x_mm or markers.pitch_y_mm):
        jobs.append(("markers", lambda: scale_from_markers(markers)))
    for i, landmarks in enumerate(folder.landmarks):
        name = "landmarks" if len(folder.landmarks) == 1 else f"landmarks_{i}"
        jobs.append((name, lambda one=landmarks, name=name: scale_from_landmarks(one, name)))
    if not jobs and not folder.presses:
        raise InputError(
            f"{folder.source} holds nothing of known length: give a board on the gel (on_gel = "
            "true, pitch_mm), [[edges]] with length_mm, [markers] with pitch_x_mm and "
            "pitch_y_mm, [[landmarks]], or ball presses with depth_mm "
            "(docs/calibration_camera.md)"
        )
    estimates: list[ScaleEstimate] = []
    failures: dict[str, str] = {}
    for done, (name, job) in enumerate(jobs):
        if progress is not None:
            progress("measuring known lengths", done, len(jobs))
        try:
            estimates.append(job())
        except InputError as error:
            failures[name] = str(error)
    if progress is not None and jobs:
        progress("measuring known lengths", len(jobs), len(jobs))
    axes = _combine(estimates)
    if folder.presses:
        _add_spheres(folder, axes, estimates, failures, progress)
        axes = _combine(estimates)
    if not axes and folder.mm_per_px is not None:
        estimates.append(_stated(folder, folder.mm_per_px))
        axes = _combine(estimates)
    if not estimates:
        raise InputError(
            f"{folder.source}: no known length could be measured:\n" + "\n".join(failures.values())
        )
    remarks = _remarks(folder, estimates, axes, failures)
    return ScaleCalibration(
        folder.source,
        _image_size(folder),
        tuple(estimates),
        axes,
        failures,
        folder.provenance,
        tuple(remarks),
    )


def _combine(estimates: list[ScaleEstimate]) -> dict[str, CombinedAxis]:
    axes = {}
    for axis in ("x", "y"):
        named = [(e.method, one) for e in estimates if (one := e.along(axis)) is not None]
        if named:
            axes[axis] = combine_axis(named)
    return axes


def _stated(folder: CaptureFolder, mm_per_px: tuple[float, float]) -> ScaleEstimate:
    """The manifest's scale, for captures that measure none: it is checked against the balls."""
    return ScaleEstimate(
        STATED,
        Estimate(mm_per_px[0], STATED_ERROR * mm_per_px[0], "mm/px"),
        Estimate(mm_per_px[1], STATED_ERROR * mm_per_px[1], "mm/px"),
        inputs={"captures": folder.provenance["manifest_sha256"]}
        if "manifest_sha256" in folder.provenance
        else {},
        remarks=(
            Remark(
                Severity.WARNING,
                "scale_stated",
                "nothing in the captures measures the scale: it is the one that they state, taken "
                f"to be right within {STATED_ERROR:.0%} (published figures of one sensor differ by "
                "more). Add a board on the gel, presses of an edge, or markers of known pitch",
            ),
        ),
    )


def _from_edges(folder: CaptureFolder) -> ScaleEstimate:
    background = folder.require_background().image()
    return scale_from_edges(*measure_edges(folder.edges, background, folder.mask))


def _add_spheres(
    folder: CaptureFolder,
    axes: dict[str, CombinedAxis],
    estimates: list[ScaleEstimate],
    failures: dict[str, str],
    progress: Progress | None,
) -> None:
    if progress is not None:
        progress("finding contacts", 0, 1)
    ratio = 1.0
    if "x" in axes and "y" in axes:
        ratio = axes["y"].estimate.value / axes["x"].estimate.value
    try:
        estimates.append(scale_from_spheres(*measure_contacts(folder, ratio), ratio))
    except InputError as error:
        failures["spheres"] = str(error)
    if progress is not None:
        progress("finding contacts", 1, 1)


def _image_size(folder: CaptureFolder) -> tuple[int, int]:
    if folder.background is not None:
        frame = folder.background
    elif folder.markers is not None:
        frame = folder.markers.rest
    elif folder.landmarks:
        frame = folder.landmarks[0].frame
    else:
        frame = next(board.frames[0] for board in folder.boards if board.entry.on_gel)
    height, width = frame.image().shape[:2]
    return width, height


def _only_limits(source: str, estimates: tuple[ScaleEstimate, ...]) -> str:
    limits = [e.upper_x for e in estimates if e.upper_x is not None]
    bound = f"; ball presses only limit it to {min(limits):.5f} mm/px" if limits else ""
    return (
        f"{source}: the captures do not determine the scale{bound}. Add a board on the gel, "
        "presses of an edge, markers of known pitch, or depth_mm of at least 3 presses"
    )


def _remarks(
    folder: CaptureFolder,
    estimates: list[ScaleEstimate],
    axes: dict[str, CombinedAxis],
    failures: dict[str, str],
) -> list[Remark]:
    remarks = [remark for estimate in estimates for remark in estimate.remarks]
    remarks += agreement_remarks(axes, estimates)
    for name, reason in failures.items():
        remarks.append(Remark(Severity.WARNING, "method_failed", f"no scale from {name}: {reason}"))
    for axis, found in axes.items():
        share = found.estimate.sigma / found.estimate.value
        if share > UNSURE_SHARE:
            remarks.append(
                Remark(
                    Severity.ERROR,
                    "scale_unsure",
                    f"the scale along {axis} is known to {share:.0%} only; add a board on the gel, "
                    "an edge or markers of known pitch",
                )
            )
    remarks += stated_scale_remarks(folder, {axis: found.estimate for axis, found in axes.items()})
    if len(axes) == 1:
        known = next(iter(axes))
        remarks.append(
            Remark(
                Severity.WARNING,
                "one_axis",
                f"only the scale along {known} was measured; pixels are taken to be square",
            )
        )
    if axes and max(found.freedom for found in axes.values()) == 0:
        remarks.append(
            Remark(
                Severity.INFO,
                "one_method",
                "the scale rests on one kind of capture; a second one would show whether its "
                "stated length is right",
            )
        )
    return remarks
