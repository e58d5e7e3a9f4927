# SPDX-License-Identifier: Apache-2.0
"""Each fault of frames on one image, as a page: what is drawn, from which range, what it looks
like."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.guards import require_size
from taccel_lab.report.page import Page, Table, format_number, picture
from taccel_lab.report.style import new_figure
from taccel_lab.signals.faulty_frames import FaultyFrames
from taccel_lab.signals.frame_faults import FRAME_KINDS, KINDS, FrameFaults
from taccel_lab.signals.frame_operators import BITS, FIELDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAIN = 4
"""Factor of the changes that are drawn."""
COLUMNS = 5
PREFIXES = {"lost_rows": "lost", "dead_lamp": "lamp", "bands": "band"}
"""Beginnings of the names of what a fault's numbers are, where that is not the kind."""


def faulty_examples(
    frames: Sequence[np.ndarray], faults: FrameFaults, seed: int
) -> dict[str, tuple[np.ndarray, Any]]:
    """The last frame with each fault, by kind, and its label.

    Args:
        frames: RGB levels 0 to 255, [h, w, 3], uint8, in their order.
        faults: Ranges; a drift is complete.
        seed: Of the draws.

    Raises:
        InputError: Fewer than two frames, or frames of several sizes.
    """
    if len(frames) < 2:
        raise InputError("give two frames or more: some faults show one that came before")
    height, width = frames[-1].shape[:2]
    for number, frame in enumerate(frames):
        require_size(f"frame {number + 1}", frame.shape[1::-1], "the last one", (width, height))
    found = {}
    for kind in KINDS:
        alone = {other: float(other == kind) for other in KINDS}
        stated = replace(faults, **alone, drift_frames=(1, 1))
        camera = FaultyFrames(stated, (width, height), 1, first=len(frames) - 1)
        seen = np.zeros_like(frames[0])
        for number, frame in enumerate(frames):
            key = (wp.array([n], dtype=wp.int32, device="cpu") for n in (seed, 0, number))
            camera.draw(*key)
            image = wp.array(frame[None].astype(np.float32), dtype=wp.float32, device="cpu")
            lit = eight_bit(camera.lit(image).numpy())
            seen = camera.sent(wp.array(lit, device="cpu")).numpy()[0]
        found[kind] = seen, camera.labels()[0]
    return found


def numbers_of(kind: str, names: Iterable[str], table: Any) -> dict[str, list[float]]:
    """The numbers of a kind in a table that has others', too, by name."""
    own = [name for name in names if name != kind and name.startswith(PREFIXES.get(kind, kind))]
    return {name: np.atleast_1d(table[name]).tolist() for name in own}


def _text(numbers: Mapping[str, list[float]]) -> str:
    cells = (f"{name} {', '.join(map(format_number, n))}" for name, n in numbers.items())
    return "; ".join(cells)


@picture("faults", f"each fault on the last frame; below it {GAIN} times what changed")
def draw_faults(
    frames: Sequence[np.ndarray], examples: Mapping[str, tuple[np.ndarray, Any]]
) -> Figure:
    """The whole frame and each of the faulty ``examples``, with their changes about a middle
    grey."""
    whole = frames[-1]
    shown = {"whole": whole, **{kind: image for kind, (image, _) in examples.items()}}
    rows = -(-len(shown) // COLUMNS)
    height = 10 / COLUMNS * whole.shape[0] / whole.shape[1]
    figure, axes = new_figure(10, rows * (2 * height + 0.3), 2 * rows, COLUMNS)
    for axis in axes.ravel():
        axis.set_axis_off()
    for number, (kind, image) in enumerate(shown.items()):
        row, column = divmod(number, COLUMNS)
        axes[2 * row, column].set_title(kind)
        axes[2 * row, column].imshow(image)
        change = image.astype(np.float32) - whole
        axes[2 * row + 1, column].imshow(eight_bit(128 + GAIN * change))
    return figure


def faults_page(
    frames: Sequence[np.ndarray],
    faults: FrameFaults,
    judged: Callable[[np.ndarray], str],
    seed: int = 0,
) -> Page:
    """The page of all faults, see ``faulty_examples``; ``judged`` says what readers make of a
    frame."""
    examples = faulty_examples(frames, faults, seed)
    stated, names = vars(faults), [name for name, _ in FIELDS]
    drawn = {kind: numbers_of(kind, names, label) for kind, (_, label) in examples.items()}
    verdicts = {kind: judged(image) for kind, (image, _) in examples.items()}
    rows = [
        (
            kind,
            f"{stated[kind]:g} of a{' frame' if kind in FRAME_KINDS else 'n episode'}",
            _text(numbers_of(kind, stated, stated)),
            _text(drawn[kind]),
            verdicts[kind],
        )
        for kind in examples
    ]
    return Page(
        "Faults of frames",
        f"Seed {seed} draws one example of each. Data sets and environments draw them by their "
        "chances, with these numbers as labels.",
        tables=[Table("Faults", ("kind", "chance", "drawn from", "here", "judged as"), rows)],
        pictures=[draw_faults(frames, examples)],
        figures={
            kind: {"bit": BITS[kind], "judged": verdicts[kind], **drawn[kind]} for kind in examples
        },
        headline=f"{len(KINDS)} kinds of faults",
    )
