# SPDX-License-Identifier: Apache-2.0
"""What a design page says: forces with their accuracy, mesh quality, how far the work is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from taccel_lab.report.page_text import PageText, page_table
from taccel_lab.sensors.base import hardness_of
from taccel_lab.sensors.derived import pad_words, size_words

if TYPE_CHECKING:
    from taccel_lab.sensors.base import FamilyParameters
    from taccel_lab.viewer.design_answer import DesignAnswer

FORMULA_PERCENT, QUICK_PERCENT = 24, 14
"""Largest difference from the default press that was measured, see docs/viewer.md."""


_WORDS = {
    "formula": "formula",
    "solid": "solid",
    "quick": "coarse press",
    "rest": "picture",
    "pressed": "picture of the press",
    "drawing": "drawing",
    "exact": "press at default accuracy",
}
"""Of ``design_answer.PIECES``."""


def heading(label: str, parameters: FamilyParameters) -> PageText:
    """Sensor, gel and image of the design."""
    pad, grid = parameters.pad(), parameters.grid()
    return PageText("**{}**: {} {} mm, {:.4g} mm thick; image {} x {} px").format(
        label, pad_words(pad), size_words(pad), pad.thickness_mm, grid.width_px, grid.height_px
    )


def stiffness_words(parameters: FamilyParameters) -> str:
    """The modulus that a hardness stands for, as it overrides the one given; empty without."""
    hardness, gel = hardness_of(parameters.values()), parameters.material()
    if hardness is None:
        return ""
    words = parameters.parameters()[hardness].worded(parameters.values()[hardness])
    between = ""
    if gel.young_interval_pa is not None:
        low, high = (1e-6 * value for value in gel.young_interval_pa)
        between = f" ({low:.3g} to {high:.3g})"
    return f"Overridden by {words}: {1e-6 * gel.young_modulus_pa:.3g} MPa{between}."


def stage_words(answer: DesignAnswer) -> PageText:
    """What is missing, since when all is there, and what this design does not have."""
    at = max(answer.seconds.values(), default=0.0)
    missing = answer.missing
    failed = PageText("**No {}:** {}")
    lines = [failed.format(_WORDS[piece], why) for piece, why in answer.failed.items()]
    if missing:
        words = " and ".join(_next(answer, missing))
        lines.insert(0, PageText("*Next: {} … ({:.1f} s)*").format(words, at))
    else:
        lines.insert(0, PageText("**Done** {:.1f} s after the change.").format(at))
    return PageText("\n\n").join(lines)


def _next(answer: DesignAnswer, missing: list[str]) -> list[str]:
    """What is worked on: one piece after the other, the default press beside them."""
    words = [_WORDS[missing[0]]]
    if missing[-1] == "exact":
        done, steps = answer.exact_steps
        where = f" (step {done + 1} of {steps})" if steps else ""
        words = [*words, _WORDS["exact"] + where][-2 if len(missing) > 1 else -1 :]
    return words


def force_table(answer: DesignAnswer) -> PageText:
    """The force three times: by the formula, quickly, and as ``press`` by default."""
    press = answer.press
    rows = []
    if not math.isnan(answer.formula_n):
        rows.append(("formula", "formula", answer.formula_n, f"± {FORMULA_PERCENT} %"))
    for name, piece, made in (
        ("coarse", "quick", answer.quick),
        ("default", "exact", answer.exact),
    ):
        if made is not None:
            share = 100 * made.error_n / max(made.force_n, 1e-12)
            within = f"± {QUICK_PERCENT} %" if piece == "quick" else f"± {share:.1f} %"
            rows.append((name, piece, made.force_n, within))
        else:
            rows.append((name, piece, math.nan, ""))
    lines = []
    for name, piece, force, within in rows:
        if not math.isnan(force):
            cells = f"{force:.4g} N | {within} | {answer.seconds.get(piece, 0.0):.1f} s"
        elif piece in answer.failed:
            cells = "none | | "
        else:
            done, steps = answer.exact_steps if piece == "exact" else (0, 0)
            cells = "… | | " + (f"step {done + 1} of {steps}" if steps else "")
        lines.append(f"| {name} | {cells} |")
    head = f"Ball of {press.radius_mm:g} mm, **{press.depth_mm:.2f} mm** deep:"
    head_of = ["| by | force | within | after |", "|---|---|---|---|"]
    return PageText("\n".join([head, "", *head_of, *lines]))  # All of it numbers and our words.


def quality_table(answer: DesignAnswer) -> PageText:
    """Figures of the mesh, and the limits that it breaks."""
    quality = answer.quality
    if quality is None:
        return PageText()
    rows = [
        ("nodes", f"{quality.node_count:,}"),
        ("tets", f"{quality.tet_count:,}"),
        ("smallest dihedral angle", f"{quality.min_dihedral_deg:.1f} deg"),
        ("its first percentile", f"{quality.p1_dihedral_deg:.1f} deg"),
        ("mean ratio, mean", f"{quality.mean_mean_ratio:.3f}"),
    ]
    table = page_table(rows, ("mesh", ""))
    if answer.refused:
        table += PageText("\n\n**Unfit:** {}").format("; ".join(answer.refused))
    return table
