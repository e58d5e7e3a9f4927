# SPDX-License-Identifier: Apache-2.0
"""What a design page says: forces with their accuracy, mesh quality, how far the work is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from taccel_lab.viewer.design_answer import Answer

FORMULA_PERCENT, QUICK_PERCENT = 24, 14
"""Largest difference from the default press that was measured, see docs/viewer.md."""


def stage_words(answer: Answer) -> str:
    """What is known, and since when."""
    last, at = list(answer.seconds.items())[-1]
    words = {
        "formula": "solid",
        "solid": "quick press",
        "quick": "mesh quality",
        "quality": "picture",
        "rest": "picture of the press",
        "pressed": "drawing",
        "drawing": "press at default accuracy",
    }
    if last == "exact":
        return f"**Done** {at:.1f} s after the change."
    return f"*Next: {words[last]} … ({at:.1f} s)*"


def force_table(answer: Answer) -> str:
    """The force three times: by the formula, quickly, and as ``press`` by default."""
    press = answer.press
    rows = []
    if not math.isnan(answer.formula_n):
        rows.append(("formula", answer.formula_n, f"± {FORMULA_PERCENT} %", "formula"))
    if answer.quick is not None:
        rows.append(("coarse", answer.quick.force_n, f"± {QUICK_PERCENT} %", "quick"))
    if answer.exact is not None:
        share = 100 * answer.exact.error_n / max(answer.exact.force_n, 1e-12)
        rows.append(("default", answer.exact.force_n, f"± {share:.1f} %", "exact"))
    lines = [
        f"| {name} | {force:.4g} N | {error} | {answer.seconds.get(piece, 0.0):.1f} s |"
        for name, force, error, piece in rows
    ]
    head = f"Ball of {press.radius_mm:g} mm, **{press.depth_mm:.2f} mm** deep:"
    return "\n".join([head, "", "| by | force | within | after |", "|---|---|---|---|", *lines])


def quality_table(answer: Answer) -> str:
    """Figures of the mesh, and the limits that it breaks."""
    quality = answer.quality
    if quality is None:
        return ""
    rows = [
        ("nodes", f"{quality.node_count:,}"),
        ("tets", f"{quality.tet_count:,}"),
        ("smallest dihedral angle", f"{quality.min_dihedral_deg:.1f} deg"),
        ("its first percentile", f"{quality.p1_dihedral_deg:.1f} deg"),
        ("mean ratio, mean", f"{quality.mean_mean_ratio:.3f}"),
    ]
    lines = [f"| {name} | {value} |" for name, value in rows]
    verdict = ["", "**Unfit:** " + "; ".join(answer.refused)] if answer.refused else []
    return "\n".join(["| mesh | |", "|---|---|", *lines, *verdict])
