# SPDX-License-Identifier: Apache-2.0
"""The README's five figures, each with the protocol that it was scored by."""

from __future__ import annotations

import statistics
from typing import Any

from taccel_lab.benchmarks.report.figures import NOTHING, Results
from taccel_lab.report.markdown import markdown_table

Row = dict[str, Any]


def headline(results: Results) -> str:
    """Image, normals, measured force, force against a finer mesh, speed."""
    rows = [
        _of_captures(
            results,
            "PSNR, placed by label [dB]",
            "Image of a real ball press [dB PSNR]",
            "[held-out test set](docs/calibration_color.md#figures), placed by label, crop of 1.6 "
            "contact radii; the untouched image scores 15.7 to 22",
        ),
        _of_captures(
            results,
            "normals, placed by label [deg]",
            "Normals from real images, mean error [deg]",
            "[the same presses](docs/calibration_depth.md), inside the contact",
        ),
        _measured_force(results),
        _mesh_error(results),
        _speed(results),
    ]
    found = [row for row in rows if row]
    return markdown_table(["what", "figure", "how it was scored"], found) if found else NOTHING


def _of_captures(results: Results, figure: str, what: str, how: str) -> list[str]:
    values = [
        f"{row['value']:.3g} ({row['set'].split(' (')[0]})"
        for document in results.get("captures", [])
        for row in document["rows"]
        if row["figure"] == figure
    ]
    return [what, ", ".join(values), how] if values else []


def _measured_force(results: Results) -> list[str]:
    worst = [
        row
        for document in results.get("captures", [])
        for row in document["rows"]
        if row["command"] == "material"
    ]
    if not worst:
        return []
    value, goal = max(row["value"] for row in worst), worst[0]["goal"]
    return [
        "Force against measurements on a GelSight Mini",
        f"{value:.1%} (goal {goal:.0%}: missed)" if value > goal else f"{value:.1%}",
        "[one modulus and a zero](docs/calibration_material.md#accuracy), worst point predicted "
        "from the others",
    ]


def _mesh_error(results: Results) -> list[str]:
    errors: dict[bool, list[float]] = {}
    for document in results.get("press_accuracy", []):
        for row in document["rows"]:
            if row["setting"] == "default" and not row["cause"]:
                ball = row["tool"].startswith("ball")
                errors.setdefault(ball, []).append(abs(row["force_error"]))
    if not errors:
        return []
    said = [
        f"{statistics.median(errors[ball]):.1%}, worst {max(errors[ball]):.0%} ({name})"
        for ball, name in ((True, "balls"), (False, "tools with edges"))
        if ball in errors
    ]
    return [
        "Mesh error of the force of a default `press`",
        "; ".join(said),
        "[against eight times as many nodes](docs/evidence/verification.md), ten sensors",
    ]


def _speed(results: Results) -> list[str]:
    in_step = _fps(results, "speed", lambda row: not row["lag"])
    whole = {
        (row["pace"], row["envs"]): row
        for document in results.get("learning", [])
        if _on_h200(document)
        for row in document["rows"]
        if row["scene"] == "peg" and not row["observed"]
    }
    counts = {envs for pace, envs in whole if ("own", envs) in whole and pace == "together"}
    if not counts & set(in_step):
        return []
    many = max(counts & set(in_step))
    together, own = whole["together", many], whole["own", many]
    failed = own["residual"]["unconverged"] / own["residual"]["env_steps"]
    return [
        f"Steps a second, {many:,} environments, H200",
        f"{in_step[many]:,.0f} all in one phase; over the whole motion with resets "
        f"{together['fps']['median']:,.0f} together, {own['fps']['median']:,.0f} at their own pace "
        f"({failed:.2%} of those steps fail)",
        "[two gels push a peg into a hole](docs/evidence/benchmarks.md#speed), residual 1e-4 of "
        "the contact force, forces read",
    ]


def _fps(results: Results, suite: str, of_interest: Any) -> dict[int, float]:
    """Of the scene ``peg`` on an H200, by environments."""
    return {
        row["envs"]: row["fps"]["median"]
        for document in results.get(suite, [])
        if _on_h200(document)
        for row in document["rows"]
        if row["scene"] == "peg" and of_interest(row)
    }


def _on_h200(document: dict[str, Any]) -> bool:
    return "H200" in document["run"]["device"]
