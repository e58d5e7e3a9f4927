# SPDX-License-Identifier: Apache-2.0
"""What calibrations and checks can remark: each kind has a code, a severity and one sentence.

The kinds of a room are in its own table, ``calibration/<room>/remarks.py``, or, where there are
few, with what remarks them (``check.py``, ``fit.py``); here are those that several remark alike.
Code that finds something calls the kind with the figures of its sentence::

    FEW_FRAMES = warning("few_frames", "{count} frames: ...")
    remarks.append(FEW_FRAMES(count=3))

``remark_table`` lists them all, for docs/remarks.md.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from taccel_lab.report.remark import Remark, Severity

_LAST_STOP = re.compile(r"(?<!\.)\.$")
_FIELD = re.compile(r"\{(\w+)[^}]*\}")
MOST_NAMED = 6


@dataclass(frozen=True)
class RemarkKind:
    """One thing that a calibration or a check can remark."""

    code: str
    """Stable name for programs, such as ``scale_disagrees``."""
    severity: Severity
    text: str
    """A sentence with named figures, as for ``str.format``: what was found, and what to do."""
    blocks: tuple[str, ...] = ()
    """Blocks that a finding about captures concerns; empty for a remark about one calibration."""
    graver: Severity | None = None
    """Its severity where the figures are bad enough, as the caller judges."""

    def __call__(
        self,
        *,
        frames: Sequence[str] = (),
        blocks: Sequence[str] | None = None,
        grave: bool = False,
        **figures: Any,
    ) -> Remark:
        """The remark with its figures.

        Args:
            frames: Names of the images it is about.
            blocks: Blocks it concerns, where these depend on the captures.
            grave: Take the graver severity.
            figures: By the names of the sentence; sentences among them without their last stop,
                which the sentence has where another one follows.
        """
        figures = {
            name: _LAST_STOP.sub("", value) if isinstance(value, str) else value
            for name, value in figures.items()
        }
        severity = self.graver if grave and self.graver is not None else self.severity
        return Remark(
            severity,
            self.code,
            self.text.format(**figures).strip(),
            tuple(frames),
            self.blocks if blocks is None else tuple(blocks),
        )


def info(
    code: str, text: str, blocks: tuple[str, ...] = (), graver: Severity | None = None
) -> RemarkKind:
    """Kind that leaves the verdict as it is."""
    return RemarkKind(code, Severity.INFO, text, blocks, graver)


def warning(
    code: str, text: str, blocks: tuple[str, ...] = (), graver: Severity | None = None
) -> RemarkKind:
    """Kind that makes a verdict at most usable."""
    return RemarkKind(code, Severity.WARNING, text, blocks, graver)


def error(code: str, text: str, blocks: tuple[str, ...] = ()) -> RemarkKind:
    """Kind that makes a verdict weak."""
    return RemarkKind(code, Severity.ERROR, text, blocks)


def remark_kinds(*packages: ModuleType) -> list[tuple[str, RemarkKind]]:
    """All kinds with the one of ``packages`` whose table holds them, in the order of the tables.

    Kinds of a package's own ``remarks`` come first, under "several".
    """
    tables: list[tuple[str, ModuleType]] = []
    for package in packages:
        rooms = [module.name for module in pkgutil.iter_modules(package.__path__) if module.ispkg]
        places = [("several", "remarks")]
        places += [
            (room, f"{room}.{name}") for room in rooms for name in ("remarks", "check", "fit")
        ]
        for room, place in places:
            name = f"{package.__name__}.{place}"
            if importlib.util.find_spec(name) is not None:
                tables.append((room, importlib.import_module(name)))
    found = [(block, kind) for block, table in tables for kind in vars(table).values()]
    kinds: list[tuple[str, RemarkKind]] = []
    for block, kind in found:  # A table may import what another one holds.
        if isinstance(kind, RemarkKind) and all(kind is not known for _, known in kinds):
            kinds.append((block, kind))
    return kinds


def remark_table(*packages: ModuleType) -> str:
    """docs/remarks.md: a list for each block, an item for each kind."""
    lines = [
        "# Remarks of calibrations and checks",
        "",
        "<!-- Made by `tools/list_remarks.py`; edit the tables in `calibration/<room>/remarks.py`",
        "and `taccel_lab/learning/force/remarks.py` instead. -->",
        "",
        "Look up a remark of a calibration or a finding of a check, by its code.",
        "",
        "```sh",
        "taccel-lab capture check captures --json     # `remarks` with their codes",
        "```",
        "",
        "Codes in `report.json` and `--json` are stable. Errors make a verdict `weak`, warnings at",
        "most `usable`. Brackets hold the severity and the blocks concerned. *Words in italics*",
        "stand for figures and names.",
    ]
    block = ""
    for name, kind in remark_kinds(*packages):
        if name != block:
            block = name
            lines += ["", f"## {name}", ""]
        severities = [kind.severity] if kind.graver is None else [kind.severity, kind.graver]
        meaning = _FIELD.sub(lambda field: f"*{field[1].replace('_', ' ')}*", kind.text)
        meaning = meaning.replace("**", "* *")
        about = "; ".join(filter(None, [" or ".join(severities), ", ".join(kind.blocks)]))
        lines.append(f"- `{kind.code}` ({about}): {meaning}")
    return "\n".join(lines) + "\n"


TOO_FEW = warning("too_few", "{found}: {wanted}", graver=Severity.ERROR)
NOTHING_HELD_OUT = warning(
    "nothing_held_out",
    "no press was held out, so that nothing tells how well other presses do; use --holdout-every 4",
)
HELDOUT_FAILED = warning(
    "heldout_failed",
    "{count} held-out presses could not be used and count as the bare gel: {reasons}",
)
LABELS_UNUSED = info(
    "labels_unused",
    "images reject the circles given with {count} presses ({names}): found ones are fitted there",
)
LABELS_REJECTED = warning(
    "labels_rejected",
    "{count} held-out presses stand beside the figures, which are over the others: their images "
    "reject the circles given with them, and they are placed where a contact is found: {names}",
)
HELDOUT_ERROR = warning(
    "heldout_error",
    "{what} that were held out are off by {error}; {advice}",
    graver=Severity.ERROR,
)
LABELS_OFF = warning(
    "labels_off",
    "{wrong} of {count} {labels} disagree with the images: {how}. {advice}",
    graver=Severity.ERROR,
)
GREY_OR_COLOUR = warning(
    "grey_or_colour",
    "the images are {found}, {expected} ones are expected: another sensor, images that were "
    "converted, or another command is meant (normals for coloured lamps, depth for grey)",
    graver=Severity.ERROR,
)
SCALE_NOT_MEASURED = warning(
    "scale_not_measured",
    "millimetres rest on {source}, which nobody measured on this unit; add a board on the gel, "
    "presses of an edge or markers of known pitch, or give a profile with a measured camera as "
    "--base",
)
SCALE_DISAGREES = warning(
    "scale_disagrees",
    "scales contradict each other: {scales}. One of the stated lengths is wrong, or the images are "
    "not of one size and crop",
    graver=Severity.ERROR,
)

PRESSES_LEFT_OUT = warning(
    "presses_left_out",
    "{lost} of {count} presses were left out: {names}. {reasons}.{advice}",
)
LIGHT_DRIFTS = warning(
    "light_drifts",
    "over {frame_count} frames the untouched gel changes by {changes} levels (standard deviation), "
    "at most {largest:.0f}. {cause}",
)

# Blocks of a profile.
BLOCK_STATE = warning("block_state", "{block}: calibrated, but {what}", graver=Severity.ERROR)
BLOCK = warning("block", "{block}: {what}", graver=Severity.ERROR)
"""Why a block is not calibrated, or what its own remark says, as grave as that."""
BLOCKS_DROPPED = warning(
    "blocks_dropped",
    "dropped from the base profile: {lost}. The profile holds for {old_width}x{old_height} px at "
    "{old_x:.4g} x {old_y:.4g} mm/px, these captures have {width}x{height} px at {x:.4g} x "
    "{y:.4g}. State the same scale, or calibrate these blocks again",
)

# How images lie on the pad.
PAD_TURNED = info(
    "pad_turned",
    "the images are upright, the catalogue's {sensor} lies down: its pad was turned by a quarter, "
    "and its camera, lights and housing with it (which way round, the catalogue cannot know)",
)
FLAT_PAD_ASSUMED = warning(
    "flat_pad",
    "flat_pad stands for a sensor that is not in the catalogue: its gel is taken as flat, bonded "
    "to a plate. How thick it is, {thickness_mm:g} mm where nothing tells it, is fitted to the "
    "ball presses, with its interval in every +- of a depth. Measure it and write thickness_mm "
    "under [design] in captures.toml, and they are narrower",
)
IMAGES_ACROSS = warning(
    "images_across",
    "the images {lie} ({width_mm:.1f} x {height_mm:.1f} mm), the pad of a {sensor} lies across "
    "them and is curved: its shape at rest is then wrong. Turn all images by a quarter, unless "
    "they are a crop",
)
SCALE_PAST_PAD = error(
    "scale_past_pad",
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm, "
    "more than the pad of {pad_x:g} x {pad_y:g} mm; check the scale, mask what lies beside the gel "
    "(mask.png), or design a larger pad",
    ("color", "normals", "depth"),
)
PAD_EDGE = info(
    "pad_edge",
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm of a "
    "pad of {pad_x:g} x {pad_y:g} mm: pixels beside the pad and within {edge:g} mm of its edge, "
    "{share:.1%} of those in use, are left out. Check the scale if the camera does not see the "
    "edge",
    ("color", "normals", "depth"),
    graver=Severity.WARNING,
)


def name_some(names: Sequence[str]) -> str:
    """A few names and how many more there are."""
    shown = ", ".join(names[:MOST_NAMED])
    return shown + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


def left_out_remarks(
    failures: Mapping[str, str], rejected: Mapping[str, float | None], unit: str
) -> list[Remark]:
    """Remarks on held-out presses that could not be used, by name with the reason, and on those
    whose labels images reject, by name with the figure where they are found (None: they are not).
    """
    found = []
    if failures:
        reasons = "; ".join(f"{name}: {why}" for name, why in failures.items())
        found.append(HELDOUT_FAILED(count=len(failures), reasons=reasons))
    if rejected:
        names = [
            name + (" (not found)" if value is None else f" ({value:.1f} {unit})")
            for name, value in rejected.items()
        ]
        found.append(LABELS_REJECTED(count=len(names), names=", ".join(names)))
    return found
