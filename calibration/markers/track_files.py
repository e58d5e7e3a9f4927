# SPDX-License-Identifier: Apache-2.0
"""Tracks as files: NumPy's npz, or one CSV row a marker and frame."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.calibration.markers.tracks import MarkerFlow, MarkerTracks, TrackStatus
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_by

SUFFIXES = (".npz", ".csv")


def require_track_file(path: Path) -> None:
    """Refuse a file of an unknown kind before any long work."""
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: tracks are written as {', '.join(SUFFIXES)}")


def write_tracks(
    path: Path, tracks: Mapping[str, MarkerTracks], flows: Mapping[str, MarkerFlow]
) -> None:
    """Write the tracks of all videos, by name, with their flow in millimetres; the suffix says how.

    Raises:
        InputError: Another suffix than .npz and .csv.
    """
    require_track_file(path)
    if path.suffix == ".npz":
        arrays = {}
        for number, (name, track) in enumerate(tracks.items()):
            prefix = f"video{number}_"
            arrays[prefix + "name"] = np.array(name)
            for key, value in _arrays(track, flows[name]).items():
                arrays[prefix + key] = value
        write_by(path, partial(np.savez_compressed, **arrays))
    else:
        with (
            atomic_file(path) as staging,
            staging.open("w", encoding="utf-8", newline="") as stream,
        ):
            writer = csv.writer(stream)
            writer.writerow(
                "video frame marker row column status u_px v_px sigma_u_px sigma_v_px x_mm y_mm "
                "dx_mm dy_mm".split()
            )
            for name, track in tracks.items():
                writer.writerows(_rows(name, track, flows[name]))


def _arrays(track: MarkerTracks, flow: MarkerFlow) -> dict[str, np.ndarray]:
    arrays = {
        "row": track.row,
        "column": track.column,
        "rest_px": track.rest_px,
        "uv_px": track.uv_px,
        "sigma_px": track.sigma_px,
        "status": track.status,
        "points_mm": flow.points_mm,
        "displacement_mm": flow.displacement_mm,
        "displacement_sigma_mm": flow.sigma_mm,
        "displacement_seen": flow.seen,
    }
    if flow.time_s is not None:
        arrays["time_s"] = flow.time_s
    return arrays


def _rows(name: str, track: MarkerTracks, flow: MarkerFlow) -> list[list[Any]]:
    rows = []
    for frame in range(track.frame_count):
        for marker in range(track.marker_count):
            on_gel = np.isfinite(flow.points_mm[marker]).all()
            mm = np.concatenate([flow.points_mm[marker], flow.displacement_mm[frame, marker]])
            rows.append(
                [
                    name,
                    frame,
                    marker,
                    track.row[marker],
                    track.column[marker],
                    TrackStatus(track.status[frame, marker]).name.lower(),
                    *track.uv_px[frame, marker].round(4),
                    *track.sigma_px[frame, marker].round(4),
                    *(mm.round(5) if on_gel else [""] * 4),
                ]
            )
    return rows
