# SPDX-License-Identifier: Apache-2.0
"""Length of the gel's skirt in the law of contacts, chosen on two sets of captures for the third.

Contacts are found without any label; each length of the skirt refits all circles of a set. The
figure is how far a found circle lies from its label beyond what all of the set have in common (the
median of u, v and radius), in per cent of the contact radius, less is better. The value with the
best mean over two sets is what the third is quoted with. Run it with
``python -m taccel_lab.benchmarks.contact_settings``; results go to
``benchmarks/results/contact_settings.json``.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from taccel_lab.benchmarks.capture_sets import CASES, ImportedSets
from taccel_lab.benchmarks.left_out import beats_default, choose_left_out
from taccel_lab.benchmarks.results import FOLDER, ResultFile, note
from taccel_lab.calibration.capture import load_captures
from taccel_lab.calibration.contacts.fit import find_contacts
from taccel_lab.calibration.contacts.photometric import fit_contacts
from taccel_lab.calibration.contacts.slope_law import SKIRT

WHAT = "length of the skirt in the law of contacts, chosen on two sets and quoted on the third"
SUITE = "contact_settings"
SKIRTS = (0.8, 1.0, SKIRT, 1.6, 2.0)
"""Damping lengths over ``sqrt(R^2 - a^2)``."""


def circles_by_skirt(folder: Path) -> tuple[dict[str, np.ndarray], dict[str, float], np.ndarray]:
    """Found circles (u, v, radius [px], shape [press, 3]) and the residual [levels] by skirt, and
    the labels of these presses."""
    captures = load_captures(folder)
    found = find_contacts(captures)
    assert found.fit is not None
    start = [contact.circle for contact in found.fit.contacts]
    labels = [captures.presses[i].circle for i in found.drifts]
    wanted = np.array([(c.u_px, c.v_px, c.radius_px) for c in labels if c is not None])
    square = np.array([1.0, captures.grid.mm_per_px_x / captures.grid.mm_per_px_y, 1.0])
    circles, residuals = {}, {}
    for skirt in SKIRTS:
        fit = fit_contacts(
            found.samples, start, found.ball_px, blur_px=found.fit.blur_px, skirt=skirt
        )
        circles[f"{skirt:g}"] = square * [
            (c.circle.u_px, c.circle.v_px, c.circle.radius_px) for c in fit.contacts
        ]
        residuals[f"{skirt:g}"] = fit.rms_levels
    return circles, residuals, wanted


def scatter_percent(circles: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """How far each circle is off its label beyond what all have in common, mean over u, v and
    radius, in per cent of the mean radius, shape [press]."""
    off = circles - labels
    return 100 * np.abs(off - np.median(off, axis=0)).mean(axis=1) / labels[:, 2].mean()


def median_errors(circles: np.ndarray, labels: np.ndarray) -> dict[str, float]:
    """As the table of docs/calibration_contacts.md has them [px]."""
    off = circles - labels
    return {
        "center_median_px": float(np.median(np.hypot(off[:, 0], off[:, 1]))),
        "radius_median_px": float(np.median(np.abs(off[:, 2]))),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=FOLDER, help="JSON file or its folder")
    options = parser.parse_args()
    default = f"{SKIRT:g}"
    with (
        tempfile.TemporaryDirectory() as scratch,
        ResultFile(SUITE, WHAT, options.out, "cpu", {"skirts": SKIRTS}).finishing() as result,
    ):
        imports = ImportedSets(Path(scratch))
        by_set = {}
        for case in CASES:
            if case.command == "contacts" and (folder := imports.folder(case)) is not None:
                by_set[case.name] = circles_by_skirt(folder)
                note(f"{case.name}: {by_set[case.name][1]}")
        scatter = {
            f"{skirt:g}": {
                name: scatter_percent(circles[f"{skirt:g}"], labels)
                for name, (circles, _, labels) in by_set.items()
            }
            for skirt in SKIRTS
        }
        choices = choose_left_out(
            {skirt: {n: -x[None] for n, x in sets.items()} for skirt, sets in scatter.items()},
            default,
        )
        for name, (circles, residuals, labels) in by_set.items():
            choice = next(c for c in choices if c.left_out == name)
            result.add(
                {
                    **asdict(choice),
                    "scatter_percent": {s: float(sets[name].mean()) for s, sets in scatter.items()},
                    "residual_levels": residuals,
                    "chosen": median_errors(circles[choice.value], labels),
                    "default": median_errors(circles[default], labels),
                }
            )
        result.put("change", beats_default(choices, default))


if __name__ == "__main__":
    main()
