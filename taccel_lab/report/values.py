# SPDX-License-Identifier: Apache-2.0
"""The figures of a report as one nested dictionary: the JSON, and what targets are judged on."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from taccel_lab.report.model import (
    ColorScore,
    ColorSection,
    DetectionSection,
    ForceDepth,
    MeshSection,
    PressSection,
    Report,
)


def report_values(report: Report) -> dict[str, Any]:
    """All figures of ``report``; the section of detection is None where it is left out."""
    return {
        "title": report.title,
        "color": _color(report.color),
        "press": _press(report.press),
        "mesh": _mesh(report.mesh),
        "detection": None if report.detection is None else _detection(report.detection),
        "timings_s": {stage.name: stage.seconds for stage in report.stages},
        "total_s": sum(stage.seconds for stage in report.stages),
        "provenance": dict(report.provenance),
    }


def look_up(values: dict[str, Any], key: str) -> float | None:
    """Number at a dotted key, None when a part of the path or the number is missing."""
    found: Any = values
    for part in key.split("."):
        if not isinstance(found, dict) or part not in found:
            return None
        found = found[part]
    if isinstance(found, bool) or not isinstance(found, (int, float, np.number)):
        return None
    return float(found) if np.isfinite(found) else None


def _score(score: ColorScore) -> dict[str, float]:
    return {key: value for key, value in asdict(score).items() if value is not None}


def _color(section: ColorSection) -> dict[str, Any]:
    heldout, background = _score(section.heldout), _score(section.background_only)
    loss = section.loss
    return {
        "heldout": heldout,
        "background_only": background,
        "gain_over_background": {
            key: heldout[key] - background[key] for key in heldout if key in background
        },
        "noise_floor_l1": section.noise_floor_l1,
        "train_count": section.train_count,
        "heldout_count": len(section.frames),
        "frames": [
            {
                "name": frame.name,
                "circle_px": list(frame.circle_px),
                **_score(frame.score),
                "background_only": _score(frame.background_score),
            }
            for frame in worst_first(section)
        ],
        "loss": {"steps": np.asarray(loss.steps), "train": np.asarray(loss.train)},
        "facts": dict(section.facts),
    }


def worst_first(section: ColorSection) -> list[Any]:
    """Held-out frames, the lowest crop PSNR first."""
    return sorted(section.frames, key=lambda frame: frame.score.crop_psnr_db)


def _press(section: PressSection) -> dict[str, Any]:
    return {
        **asdict(section.reference),
        "records": [asdict(record) for record in section.records],
        "smallest_distance_m": min(r.min_distance_m for r in (section.reference, *section.records)),
        "force_depth": _force_depth(section.force_depth),
        "facts": dict(section.facts),
    }


def _force_depth(curve: ForceDepth) -> dict[str, Any]:
    return {
        "label": curve.label,
        "depth_mm": np.asarray(curve.depth_mm),
        "force_n": np.asarray(curve.force_n),
    }


def _mesh(section: MeshSection) -> dict[str, Any]:
    angles = np.ravel(section.dihedral_deg)
    counts, edges = np.histogram(angles, bins=np.arange(0, 181, 5))
    return {
        "node_count": section.node_count,
        "tet_count": section.tet_count,
        "min_dihedral_deg": section.min_dihedral_deg,
        "max_dihedral_deg": float(angles.max()) if len(angles) else None,
        "dihedral_histogram": {"edges_deg": edges, "counts": counts},
        "facts": dict(section.facts),
    }


def _detection(section: DetectionSection) -> dict[str, Any]:
    error = section.detected_px - section.labelled_px
    found = np.isfinite(error).all(axis=1)
    center = np.hypot(error[found, 0], error[found, 1])
    radius = np.abs(error[found, 2])
    return {
        "count": len(error),
        "found": int(found.sum()),
        "center_error_px": _spread(center),
        "radius_error_px": _spread(radius),
        "radius_bias_px": float(error[found, 2].mean()) if found.any() else None,
        "frames": [
            {"name": name, "labelled_px": labelled, "detected_px": detected}
            for name, labelled, detected in zip(
                section.names, section.labelled_px, section.detected_px, strict=True
            )
        ],
    }


def _spread(values: np.ndarray) -> dict[str, float] | None:
    if len(values) == 0:
        return None
    return {
        "median": float(np.median(values)),
        "p90": float(np.quantile(values, 0.9)),
        "max": float(values.max()),
    }
