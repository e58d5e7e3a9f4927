# SPDX-License-Identifier: Apache-2.0
"""Sums by atomics that do not depend on the order of their addends.

Atomic additions arrive in any order on a GPU, and each rounds. They do not where all addends of a
place are multiples of one power of two that is coarse enough for every partial sum: then the sum is
exact in any order. So addends are rounded to such a grid first, as in pre-rounded summation [Rump,
Ogita and Oishi 2008; Demmel and Nguyen 2013, Fast reproducible floating-point summation]. With
n addends of a place, of which the largest is below 2^e, the grid is 2^(e + log2 n - 51) or finer: a
place with a dozen of them keeps 47 bits of the largest.

Where the grid lies is found by the same kernel over the same addends, launched once to measure and
once more to add. What is added to must be zero before.
"""

from __future__ import annotations

from collections.abc import Iterator

import warp as wp

wp.set_module_options({"enable_backward": False})

MEASURE = wp.constant(1)
ROUND = wp.constant(2)


@wp.struct
class SumStage:
    """What becomes of addends.

    stage: 0 added as they are, MEASURE noted but not added, ROUND added on the grid of their place.
    seen: largest exponent of the addends of a place, as the bits of a double have it, and their
    number, [env_count, place_count, 2].
    """

    stage: wp.int32
    seen: wp.array3d(dtype=wp.int32)


@wp.func_native("""
    int largest = 0;
    for (int i = 0; i < 3; ++i) {
        union { double value; unsigned long long bits; } number;
        number.value = value[i];
        const int exponent = static_cast<int>(number.bits >> 52) & 2047;
        largest = exponent > largest ? exponent : largest;
    }
    return largest;
""")
def vector_exponent(value: wp.vec3d) -> int:
    """Exponent e + 1023 of the largest component, in [2^e, 2^(e + 1)); 0 of zero, 2047 of what is
    not finite."""
    ...


@wp.func_native("""
    int largest = 0;
    for (int i = 0; i < 9; ++i) {
        union { double value; unsigned long long bits; } number;
        number.value = block.data[i / 3][i % 3];
        const int exponent = static_cast<int>(number.bits >> 52) & 2047;
        largest = exponent > largest ? exponent : largest;
    }
    return largest;
""")
def block_exponent(block: wp.mat33d) -> int:
    """``vector_exponent`` of a block."""
    ...


@wp.func_native("""
    union { double value; unsigned long long bits; } number;
    number.value = static_cast<double>(count);
    const int doublings = (static_cast<int>(number.bits >> 52) & 2047) - 1023;
    const int place = exponent + doublings + 2;
    number.bits = static_cast<unsigned long long>(place < 2047 ? place : 2047) << 52 | 1ull << 51;
    return number.value;
""")
def anchor_of(exponent: int, count: int) -> wp.float64:
    """A number 1.5 2^k whose last bit is the grid of ``count`` (1 or more) addends: adding it to
    one of them and taking it away again rounds that. Not a number where one is not finite."""
    ...


@wp.func_native("""
    wp::mat_t<3, 3, wp::float64> rounded;
    for (int i = 0; i < 9; ++i)
        rounded.data[i / 3][i % 3] = (block.data[i / 3][i % 3] + anchor) - anchor;
    return rounded;
""")
def rounded_block(block: wp.mat33d, anchor: wp.float64) -> wp.mat33d:
    """Every entry on the grid of the anchor."""
    ...


@wp.func
def note_addend(env: int, place: int, exponent: int, sums: SumStage):
    """One addend more, the exponent of whose largest component is given."""
    wp.atomic_max(sums.seen, env, place, 0, exponent)
    wp.atomic_add(sums.seen, env, place, 1, 1)


@wp.func
def place_anchor(env: int, place: int, sums: SumStage) -> wp.float64:
    """The anchor of a place whose addends were noted."""
    return anchor_of(sums.seen[env, place, 0], sums.seen[env, place, 1])


@wp.func_native("""
    double* const entry = reinterpret_cast<double*>(
        totals.data + size_t(env) * totals.shape[1] + place);
    for (int i = 0; i < 3; ++i) {
        double addend = value[i];
        if (anchor != 0.0)
            addend = (addend + anchor) - anchor;
#if defined(__CUDA_ARCH__)
        atomicAdd(entry + i, addend);
#else
        entry[i] += addend;
#endif
    }
""")
def _add_rounded(
    env: int, place: int, value: wp.vec3d, anchor: wp.float64, totals: wp.array2d(dtype=wp.vec3d)
) -> None:
    """Add on the grid of an anchor, or as it is where that is zero."""
    ...


@wp.func
def add_vector(
    env: int, place: int, value: wp.vec3d, totals: wp.array2d(dtype=wp.vec3d), sums: SumStage
):
    """Add to one of the vectors of an environment, [env_count, place_count], or note it."""
    anchor = wp.float64(0.0)
    if sums.stage > 0:
        if sums.stage == MEASURE:
            note_addend(env, place, vector_exponent(value), sums)
            return
        anchor = place_anchor(env, place, sums)
    _add_rounded(env, place, value, anchor, totals)


class ReproducibleSums:
    """The stages in which the sums of an array are formed: one that adds addends as they are, or
    two."""

    def __init__(self, shape: tuple[int, int], device: wp.Device, in_any_order: bool) -> None:
        """``shape``: [env_count, place_count] of what is added to. ``in_any_order``: whether sums
        shall be the same bits in any order."""
        self._seen = None
        if in_any_order:
            self._seen = wp.zeros((*shape, 2), dtype=wp.int32, device=device)

    def stages(self) -> Iterator[SumStage]:
        """What to launch the kernels with that add, one launch of all of them after the other."""
        if self._seen is None:
            yield SumStage()
            return
        self._seen.zero_()
        for number in (MEASURE, ROUND):
            stage = SumStage()
            stage.stage, stage.seen = int(number), self._seen
            yield stage
