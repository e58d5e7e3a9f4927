# SPDX-License-Identifier: Apache-2.0
"""Marker flows of videos whose tool's path was recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.folder import Video
from taccel_lab.calibration.markers.fit import calibrate_markers
from taccel_lab.calibration.markers.flow import MarkerFlow, marker_flow_mm
from taccel_lab.calibration.material.tool_path import ToolPath
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.report.remark import Remark, Severity


@dataclass(frozen=True)
class PathFlow:
    """Motion of markers, and of the ball that moves them."""

    name: str
    sha256: str
    flow: MarkerFlow
    path: ToolPath


def videos_with_path(folder: CaptureFolder) -> list[Video]:
    """Videos of presses, shears and twists whose path says the depth."""
    if folder.markers is None:
        return []
    return [v for v in folder.markers.videos if "z_mm" in v.poses]


def flows_of_folder(
    folder: CaptureFolder, profile: SensorProfile
) -> tuple[list[PathFlow], list[Remark]]:
    """Tracked markers of the videos with a path, in millimetres, and what the tracking remarks.

    Raises:
        InputError: A path that does not fit its video, or no ball that could have made it.
    """
    videos = videos_with_path(folder)
    if not videos or folder.markers is None:
        return [], []
    if folder.ball_radius_mm is None:
        raise InputError(
            f"{folder.source}: marker videos with a path need the ball that made them: give "
            '[indenter] kind = "sphere" and radius_mm'
        )
    paths = []
    for video in videos:
        path = ToolPath.of_poses(video.poses, video.source)
        if len(path.depth_mm) != video.frame_count:
            raise InputError(
                f"{video.source}: the path has {len(path.depth_mm)} rows, the video "
                f"{video.frame_count} frames; one row a frame"
            )
        paths.append(path)
    tracked = calibrate_markers(
        replace(folder, markers=replace(folder.markers, videos=tuple(videos))), profile
    )
    flows = [
        PathFlow(
            f"flow_{video.source.replace(chr(92), '/').rsplit('/', 1)[-1]}",
            video.sha256,
            marker_flow_mm(followed.tracks, tracked.view, fps=video.entry.fps),
            path,
        )
        for video, followed, path in zip(videos, tracked.videos, paths, strict=True)
    ]
    kept = [r for r in tracked.remarks if r.severity is not Severity.INFO]
    return flows, kept
