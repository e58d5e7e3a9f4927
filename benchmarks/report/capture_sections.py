# SPDX-License-Identifier: Apache-2.0
"""Generated parts of the pages about calibration on captures, in Markdown."""

from __future__ import annotations

from collections.abc import Iterator

from taccel_lab.benchmarks.report.figures import Document, number
from taccel_lab.report.markdown import markdown_table


def captures(document: Document) -> Iterator[str]:
    """Calibrations of published captures against their goals."""
    rows = [
        [
            row["set"],
            f"`{row['command']}`",
            row["figure"],
            number(row["value"]),
            f"{'at least' if row['at_least'] else 'at most'} {row['goal']:g}",
            "met" if row["met"] else "**missed**",
            row["verdict"] or "-",
            "-" if row["fit_seconds"] is None else number(row["fit_seconds"], 2),
            number(row["seconds"], 3),
        ]
        for row in document["rows"]
    ]
    head = ["captures", "calibration", "figure", "value", "goal", "", "verdict", "fit [s]"]
    yield markdown_table([*head, "command [s]"], rows)


def check_errors(document: Document) -> Iterator[str]:
    """Named presses of all, good and spoiled, a row a fault and a column a set."""
    rows = document["rows"]
    sets = list(dict.fromkeys(row["set"] for row in rows))
    cases = dict.fromkeys((row["case"], row.get("code", "any of those below")) for row in rows)
    counts = {(row["case"], row["set"]): f"{row['named']} of {row['count']}" for row in rows}
    yield markdown_table(
        ["presses", "named by", *sets],
        [
            [case, f"`{code}`" if "_" in code or code.isalpha() else code]
            + [counts.get((case, name), "-") for name in sets]
            for case, code in cases
        ],
    )


_HELD_OUT = {
    "heldout": "objects and units that training never saw",
    "heldout_at_rest": "their untouched images",
    "heldout_same_light": "in the background's own light",
}


def forces(document: Document) -> Iterator[str]:
    """Errors of the force model on touches it never saw, and wrong images that it noticed."""
    settings, rows = document["settings"], document["rows"]
    counts = ", ".join(f"{count:,} for {name}" for name, count in settings["images"].items())
    yield f"{settings['data']}; {counts}. {settings['split']['rule']}."
    judged = [row for row in rows if "fz_n" in row]
    yield markdown_table(
        [
            "inputs", "of", "images", "force along z [N]", "of [N]", "median",
            "along the face [N]", "of [N]", "about z [N mm]", "area [mm2]", "patch [N]",
            "within 95 %",
        ],
        [
            [
                row["inputs"],
                _HELD_OUT.get(row["by"]) or f"{row['by']} {row['name']}",
                f"{row['images']:,}",
                number(row["fz_n"]),
                number(row["fz_spread_n"]),
                "-" if row["fz_relative"] is None else f"{row['fz_relative']:.1%}",
                *(number(row[name]) for name in ("shear_n", "shear_spread_n", "tz_nmm")),
                *(number(row[name]) for name in ("area_mm2", "patch_n")),
                f"{row['inside95']:.0%}",
            ]
            for row in judged
        ],
    )  # fmt: skip
    yield markdown_table(
        ["inputs", "images that are none of this sensor's", "images", "called outside"],
        [
            [row["inputs"], row["name"], f"{row['images']:,}", f"{row['outside']:.1%}"]
            for row in rows
            if "outside" in row
        ],
    )
