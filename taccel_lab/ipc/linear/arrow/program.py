# SPDX-License-Identifier: Apache-2.0
"""Block-arrow factorisation, laid out for one thread block.

Every index that the factorisation and its solves need is one word of a program of integers, which
the block copies next to the numbers before it starts: a level then waits for shared memory alone.
How much of that a block can have depends on the chip, and the less it takes, the more blocks work
on a multiprocessor at a time: kernels are compiled for a few sizes, and the smallest that holds the
factor is taken. What is too long for that leaves the words in global memory, then the numbers too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import MAX_LANES
from taccel_lab.ipc.linear.arrow.elimination import Elimination, eliminate
from taccel_lab.model.matrix_pattern import BlockPattern

ROOMS_KIB = (48, 99, 113, 163, 227)
"""Shared memory of a block for which kernels are compiled: what every chip has; RTX 30, 40 and 50
(sm_86, 89, 120); half of an H100, H200 or B200 (sm_90, 100); A100 (sm_80); all of an H100."""
STATIC_BYTES = 4096
"""What Warp and ``team_sum`` take of that beside our numbers."""
HASTES = (1.0, 0.25, 0.0)
"""See ``least_degree_order``; two gels of 83 nodes take 20, 22 and 22 levels."""
BORDER_CHUNKS = 32
"""Partial sums of a border row in a solve."""
SCHUR_CHUNKS = 8
"""Partial sums of an element of the Schur complement."""


@wp.struct
class ArrowLayout:
    """Sizes and places; n gel rows, m border rows, b blocks.

    Places among the numbers, where the factor [9 b] starts at 0: roots, inverses of the diagonal
    blocks of the factor, [9 n]; r, z, x: vectors by places, [3 (n + m)]; schur: two copies,
    [18 m m]; sums: partial sums; flag: see ``load_matrix``; words: those of 32 bits.
    Places among the words:
    pair_starts: range of each block in pairs, [b + 1]; pairs: a 2^16 + b.
    owners: column 2^16 + its diagonal block, of each block, [b].
    level_starts: first block of each level, and the end, [level_count + 1].
    starts: first block of each column, [n].
    step_starts: first target of each step of a solve, and the end; the first ``forward_steps`` go
    forward, the others back.
    targets: row 2^16 + first entry, and one more for the end.
    entries: block 2^16 + place of the row that it multiplies.
    """

    n: int
    m: int
    blocks: int
    level_count: int
    forward_steps: int
    step_count: int
    roots: int
    r: int
    z: int
    x: int
    schur: int
    sums: int
    flag: int
    words: int
    word_count: int
    pair_starts: int
    pairs: int
    owners: int
    level_starts: int
    starts: int
    step_starts: int
    targets: int
    entries: int


@dataclass(frozen=True)
class ArrowProgram:
    """Words and layout of a factorisation."""

    layout: ArrowLayout
    words: np.ndarray
    """int32, [word_count]."""
    numbers: int
    """float64 numbers that all of it takes."""

    addressable: bool
    """Whether halves of words are long enough for its indices."""

    def placement(self, limit_bytes: int, beside: bool = False) -> Placement:
        """The least shared memory that holds as much as possible of it, of at most
        ``limit_bytes`` a block. With ``beside`` two blocks share that if it holds the numbers of
        both: each works while the other waits, in 2 to 8 % less of a step's time on an H200."""
        if beside:
            # Of each block a chip keeps one KiB for itself.
            half = self.placement((limit_bytes + 1024) // 2 - 1024)
            if half.room:
                return half
        rooms = [(1024 * kib - STATIC_BYTES) // 8 for kib in ROOMS_KIB if 1024 * kib <= limit_bytes]
        for size, words_inside in ((self.numbers, True), (self.layout.words, False)):
            for room in rooms:
                if size <= room:
                    return Placement(room, words_inside)
        return Placement(0, False)


@dataclass(frozen=True)
class Placement:
    """Which memory a thread block works in."""

    room: int
    """float64 numbers of shared memory; 0: all is in global memory."""
    words_inside: bool
    """Whether that holds the words, too."""

    @property
    def shared_bytes(self) -> int:
        """Shared memory that a block takes in all."""
        return 8 * self.room + STATIC_BYTES

    def __str__(self) -> str:
        if not self.room:
            return "global memory"
        lists = "" if self.words_inside else ", its lists in global memory"
        return f"{self.shared_bytes // 1024} KiB of shared memory{lists}"


def plan_arrow(
    pattern: BlockPattern,
    clusters: list[tuple[int, int]],
    limit_bytes: int,
    hastes: Sequence[float] = HASTES,
) -> tuple[Elimination, ArrowProgram]:
    """Factorisation with the rows of affine bodies, ``clusters``, as the border, for blocks that
    may have ``limit_bytes``: the order that needs the least shared memory, with fewer levels among
    equals, or that is the shortest where there is none."""
    none = np.zeros(0, dtype=np.int64)
    border = np.concatenate([none, *(np.arange(first, end) for first, end in clusters)])
    plans = [eliminate(pattern, border, haste) for haste in hastes]

    def rank(found: tuple[Elimination, ArrowProgram]) -> tuple[bool, bool, bool, int]:
        program = found[1]
        place = program.placement(limit_bytes)
        size = place.room or program.numbers
        return not program.addressable, not place.room, not place.words_inside, size

    return min([(plan, arrow_program(plan)) for plan in plans], key=rank)


def arrow_program(plan: Elimination) -> ArrowProgram:
    """Program of a symbolic factorisation."""
    n, m, blocks = len(plan.order), len(plan.border), plan.block_count
    width = 3 * m
    layout = ArrowLayout()
    layout.n, layout.m, layout.blocks = n, m, blocks
    layout.level_count = len(plan.level_columns) - 1
    room = 9 * blocks
    products = 9 * (m * (m + 1) // 2) + width
    sums = max(SCHUR_CHUNKS * products, BORDER_CHUNKS * width)
    for name, size in (
        ("roots", max(9 * n, 3 * (n + m))),
        ("r", 3 * (n + m)),
        ("z", 3 * (n + m)),
        ("schur", 2 * width * width),
        ("sums", sums),
        ("flag", 2),
    ):
        setattr(layout, name, room)
        room += size
    # Nobody needs the roots any more when a solve begins.
    layout.x = layout.roots
    below, rows_below = plan.inner.T
    own_columns = plan.columns[below]
    forward = _steps(plan.level_columns, below, own_columns, rows_below)
    back = _steps(plan.level_columns, below, rows_below, own_columns)[::-1]
    # As it factors, a level takes over what the level before it gives (``factor_columns``).
    assert len(forward) == max(layout.level_count - 1, 0)
    layout.forward_steps, layout.step_count = len(forward), len(forward) + len(back)
    steps = forward + back
    targets = [(row, len(entries)) for step in steps for row, entries in step]
    firsts = np.concatenate([[0], np.cumsum([count for _, count in targets])]).astype(np.int64)
    rows = np.array([row for row, _ in targets] + [0], dtype=np.int64)
    entries = np.array(
        [entry for step in steps for _, entries in step for entry in entries], dtype=np.int64
    ).reshape(-1, 2)
    sections = {
        "pair_starts": plan.pair_starts,
        "pairs": _joined(plan.pairs[:, 0], plan.pairs[:, 1]),
        "owners": _joined(plan.columns, plan.starts[plan.columns]),
        "level_starts": plan.level_starts,
        "starts": plan.starts,
        "step_starts": np.concatenate([[0], np.cumsum([len(step) for step in steps])]),
        "targets": _joined(rows, firsts),
        "entries": _joined(entries[:, 0], entries[:, 1]),
    }
    place = 0
    for name, section in sections.items():
        setattr(layout, name, place)
        place += len(section)
    # Lanes without a task read ahead all the same; words are copied in pairs.
    sections["end"] = np.zeros(MAX_LANES // 2 + place % 2, dtype=np.int64)
    words = np.concatenate(list(sections.values())).astype(np.int64)
    layout.words, layout.word_count = room, len(words)
    addressable = max(blocks, len(entries), n + m) < 1 << 16
    # Halves that run over belong to programs that nobody runs.
    words = words.astype(np.uint32).astype(np.int32)
    return ArrowProgram(layout, words, room + (len(words) + 1) // 2, addressable)


def _joined(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    return high.astype(np.int64) << 16 | low.astype(np.int64)


Step = list[tuple[int, list[tuple[int, int]]]]
"""(row, [(block, place of the row that it multiplies)]) of all rows that a step changes."""


def _steps(
    level_columns: np.ndarray, blocks: np.ndarray, givers: np.ndarray, takers: np.ndarray
) -> list[Step]:
    """What the rows of each level give to others once they are known; levels that give nothing are
    left out. Block ``blocks[k]`` takes what is at place ``givers[k]`` to place ``takers[k]``."""
    levels = np.searchsorted(level_columns, givers, side="right") - 1
    steps: dict[int, dict[int, list[tuple[int, int]]]] = {}
    for k in np.lexsort((givers, takers, levels)).tolist():
        step = steps.setdefault(int(levels[k]), {})
        step.setdefault(int(takers[k]), []).append((int(blocks[k]), int(givers[k])))
    return [list(steps[level].items()) for level in sorted(steps)]
