# SPDX-License-Identifier: Apache-2.0
"""Block-arrow factorisation: the symbolic part, laid out for one thread block.

The symbolic part is done once a scene. Rows of gels are eliminated in the order of least degree
[Tinney and Walker 1967]; rows of affine bodies come last, as a border that is dense: a body may
touch any gel node, and contact of a gel with a body fills in nothing else. Columns that do not
depend on each other form a level, which a GPU eliminates at one time.

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
from taccel_lab.model.matrix_pattern import BlockPattern


@dataclass(frozen=True)
class Elimination:
    """Blocks of the factor, ordered by levels, and what has to be subtracted from which.

    A column has its diagonal block first, then those of all border rows, then those of gel rows.
    Places number the gel rows in the order of elimination.
    """

    order: np.ndarray
    """Row of the system at each place, [column_count]."""
    border: np.ndarray
    """Rows of the system in the border, ascending, [border_count]."""
    starts: np.ndarray
    """First block of each column, by places, [column_count]."""
    level_starts: np.ndarray
    """First block of each level, and the end, [level_count + 1]."""
    level_columns: np.ndarray
    """First place of each level, and the end: places are ordered by levels, [level_count + 1]."""
    columns: np.ndarray
    """Place of the column of each block, [block_count]."""
    codes: np.ndarray
    """Block of the pattern that each block starts from as 2 block + transposed, -1 for zero."""
    pair_starts: np.ndarray
    """Range of each block in ``pairs``, [block_count + 1]."""
    pairs: np.ndarray
    """Blocks a, b: a b^T is subtracted from the block, [pair_count, 2]."""
    inner: np.ndarray
    """(block, place of its row) of the blocks of gel rows below the diagonal, by columns,
    [inner_count, 2]."""

    @property
    def block_count(self) -> int:
        """Blocks of the factor, without those of the border among itself."""
        return len(self.columns)


def least_degree_order(
    neighbours: list[set[int]], haste: float = 0.0
) -> tuple[list[int], list[set[int]]]:
    """Order of elimination, and the rows that each eliminated one leaves coupled.

    A row with ``haste`` neighbours less is not preferred to one that can go a level earlier; among
    equals the earlier goes first. Haste means fewer levels, and more blocks.
    """
    graph = [set(n) for n in neighbours]
    waiting = set(range(len(graph)))
    level = [0] * len(graph)
    order, left = [], []
    while waiting:
        node = min(waiting, key=lambda i: (len(graph[i]) + haste * level[i], level[i], i))
        waiting.discard(node)
        others = graph[node]
        for other in others:
            graph[other] |= others
            graph[other] -= {other, node}
            level[other] = max(level[other], level[node] + 1)
        order.append(node)
        left.append(set(others))
    return order, left


def eliminate(pattern: BlockPattern, border: np.ndarray, haste: float = 0.0) -> Elimination:
    """Symbolic factorisation of ``pattern`` with the rows ``border`` last; see
    ``least_degree_order`` for ``haste``."""
    n = pattern.free_count
    is_border = np.zeros(n, dtype=bool)
    is_border[border] = True
    border = np.flatnonzero(is_border)
    inside = np.flatnonzero(~is_border)
    local = np.full(n, -1)
    local[inside] = np.arange(len(inside))
    neighbours: list[set[int]] = [set() for _ in inside]
    for row, column in zip(pattern.rows.tolist(), pattern.columns.tolist(), strict=True):
        if row != column and local[row] >= 0 and local[column] >= 0:
            neighbours[local[row]].add(int(local[column]))
            neighbours[local[column]].add(int(local[row]))
    sequence, left = least_degree_order(neighbours, haste)
    turn = np.empty(len(sequence), dtype=np.int64)
    turn[sequence] = np.arange(len(sequence))
    below = [sorted(int(turn[i]) for i in rows) for rows in left]
    # The level of a column is one more than the highest that it depends on.
    level = np.zeros(len(below), dtype=np.int64)
    for column, rows in enumerate(below):
        for row in rows:
            level[row] = max(level[row], level[column] + 1)
    by_level = np.lexsort((np.arange(len(below)), level))
    place = np.empty_like(by_level)
    place[by_level] = np.arange(len(by_level))
    structure = [sorted(int(place[i]) for i in below[column]) for column in by_level]
    order = inside[np.array(sequence, dtype=np.int64)[by_level]]
    return _number_blocks(pattern, order, border, structure, np.sort(level))


def _number_blocks(
    pattern: BlockPattern,
    order: np.ndarray,
    border: np.ndarray,
    structure: list[list[int]],
    levels: np.ndarray,
) -> Elimination:
    """Blocks and pairs of a factor whose columns have the gel rows ``structure``."""
    m = len(border)
    sizes = np.array([1 + m + len(rows) for rows in structure], dtype=np.int64)
    starts = np.cumsum(sizes) - sizes
    count = len(order)
    place_of = {count + c: c for c in range(m)}
    index = {}
    rows_of_blocks: list[int] = []
    for column, rows in enumerate(structure):
        block = int(starts[column])
        all_rows = [column, *place_of, *rows]
        for k, row in enumerate(all_rows):
            index[row, column] = block + k
        rows_of_blocks += all_rows
    pairs: list[list[tuple[int, int]]] = [[] for _ in rows_of_blocks]
    for column, rows in enumerate(structure):
        # Each later row j of this column takes a b^T from all rows i >= j of it.
        first = int(starts[column])
        extent = [*rows, *place_of]
        for k, j in enumerate(rows):
            b = index[j, column]
            for i in extent[k:]:
                pairs[index[i, j]].append((index[i, column], b))
        assert rows_of_blocks[first] == column
    rows_array = np.array(rows_of_blocks, dtype=np.int64)
    columns = np.repeat(np.arange(count), sizes)
    system_row = np.concatenate([order, border])
    level_count = int(levels.max(initial=-1)) + 1
    level_columns = np.searchsorted(levels, np.arange(level_count + 1))
    inner = [(index[i, j], i) for j, rows in enumerate(structure) for i in rows]
    block_starts = np.append(starts, sizes.sum())
    pair_starts, flat_pairs = _flat(pairs)
    return Elimination(
        order=order,
        border=border,
        starts=starts,
        level_starts=block_starts[level_columns],
        level_columns=level_columns,
        columns=columns,
        codes=_codes(pattern, system_row[rows_array], order[columns]),
        pair_starts=pair_starts,
        pairs=flat_pairs,
        inner=np.array(inner, dtype=np.int64).reshape(-1, 2),
    )


def _flat(lists: list[list[tuple[int, int]]]) -> tuple[np.ndarray, np.ndarray]:
    """Starts [count + 1] and entries [entry, 2] of lists of pairs."""
    starts = np.concatenate([[0], np.cumsum([len(entries) for entries in lists])])
    flat = [pair for entries in lists for pair in entries]
    return starts.astype(np.int64), np.array(flat, dtype=np.int64).reshape(-1, 2)


def _codes(pattern: BlockPattern, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """2 block + transposed of places of the full matrix in the pattern, -1 where it has none."""
    keys = pattern.rows.astype(np.int64) * pattern.free_count + pattern.columns
    key = np.maximum(rows, columns) * pattern.free_count + np.minimum(rows, columns)
    found = np.minimum(np.searchsorted(keys, key), len(keys) - 1)
    return np.where(keys[found] == key, 2 * found + (rows < columns), -1)


def border_codes(pattern: BlockPattern, border: np.ndarray) -> np.ndarray:
    """Codes of the blocks of border rows among themselves, row by row, [border_count^2]."""
    rows, columns = (index.ravel() for index in np.meshgrid(border, border, indexing="ij"))
    return _codes(pattern, rows, columns)


ROOMS_KIB = (48, 99, 113, 163, 227)
"""Shared memory of a block for which kernels are compiled: what every chip has; RTX 30, 40 and 50
(sm_86, 89, 120); half of an H100, H200 or B200 (sm_90, 100); A100 (sm_80); all of an H100."""
STATIC_BYTES = 4096
"""What Warp and ``team_sum`` take of that beside our numbers."""
HASTES = (1.0, 0.25, 0.0)
"""See ``least_degree_order``; two gels of 83 nodes take 20, 22 and 22 levels."""
BORDER_CHUNKS = 32
"""Partial sums of a border row in a solve."""
SCHUR_CHUNKS = 6
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
    triangle = width * (width + 1) // 2
    sums = max(SCHUR_CHUNKS * triangle, (BORDER_CHUNKS + 1) * width)
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
    # Lanes without a task read ahead all the same.
    sections["end"] = np.zeros(MAX_LANES // 2, dtype=np.int64)
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
