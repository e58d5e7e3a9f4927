# SPDX-License-Identifier: Apache-2.0
"""Block-arrow factor: its program and its memory, exact solutions, and what breaks them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.linear.arrow.elimination import eliminate
from taccel_lab.ipc.linear.arrow.program import (
    ROOMS_KIB,
    STATIC_BYTES,
    arrow_program,
    plan_arrow,
)
from taccel_lab.ipc.linear.arrow.solver import Arrow
from taccel_lab.ipc.linear.problem.arrays import LinearReport
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import block_pattern
from tests.ipc.linear.systems import (
    contact_system,
    delaunay_pattern,
    residuals,
    solve,
    touch_elsewhere,
    turned,
    with_contact_in_pattern,
)

CPU = wp.get_device("cpu")
TOLERANCE = 1e-9


def factorise(system: LinearSystem, *active: int, lanes: int = 32, kib: int = 227) -> LinearReport:
    system._solver = Arrow(system, system.clusters, lanes, 1024 * kib)
    return solve(system, TOLERANCE, active, 100)


@pytest.mark.parametrize(
    ("lanes", "kib"), [(32, 163), pytest.param(64, 163, marks=pytest.mark.slow), (32, 99), (32, 48)]
)
@pytest.mark.parametrize("listed", [True, False])
def test_a_gel_and_a_body_are_solved_exactly(
    many_lanes: None, listed: bool, lanes: int, kib: int
) -> None:
    """With contact in the list, and in the pattern; in shared memory, in both, in global memory."""
    system, dense = contact_system(2)
    system = system if listed else with_contact_in_pattern(system, dense)
    report = factorise(system, 1, 1, lanes=lanes, kib=kib)
    assert report.iterations.tolist() == [1, 1] and not report.breakdown.any()
    found = system.solution.numpy().reshape(2, -1)
    expected = np.linalg.solve(dense, system.rhs.numpy().reshape(2, -1, 1))[..., 0]
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize(("bodies", "kib"), [(0, 227), (1, 227), (1, 48), (2, 227)])
def test_gels_in_contact_are_left_to_cg(many_lanes: None, bodies: int, kib: int) -> None:
    """Blocks between bodies belong to the border, and one iteration is enough."""
    system, dense = contact_system(1, contacts=10, bodies=bodies)
    touch_elsewhere(system, dense, bodies)
    report = factorise(system, 1, kib=kib)
    (residual,) = residuals(system, dense)
    if bodies < 2:
        assert 1 < report.iterations[0] < 20
        assert report.relative_residual[0] == pytest.approx(residual, rel=0.1)
    else:
        assert report.iterations[0] == 1
    assert residual <= 1.01 * TOLERANCE


@pytest.mark.thorough
def test_environments_do_not_see_each_other(many_lanes: None) -> None:
    """Nor what rests, is not positive definite, or is not finite."""
    system, dense = contact_system(5)
    values = system.values.numpy()
    values[1] = np.nan
    values[2, system.pattern.diagonal[7]] *= -1.0
    values[3, 11, 1, 2] = np.nan
    system.values.assign(values)
    report = factorise(system, 1, 0, 1, 1, 1)
    assert report.iterations.tolist() == [1, 0, 1, 0, 1]
    assert report.breakdown.tolist() == [False, False, True, True, False]
    assert report.relative_residual.tolist() == [0, 0, 0, 1, 0]
    solution = system.solution.numpy()
    assert (solution[[1, 3]] == 0).all() and (residuals(system, dense)[[0, 4]] <= TOLERANCE).all()
    # Alone they come out the same to the last bit.
    values[1:4] = values[0]
    system.values.assign(values)
    for env in (0, 4):
        factorise(system, *(int(other == env) for other in range(5)))
        np.testing.assert_array_equal(system.solution.numpy()[env], solution[env])


def test_a_pivot_that_is_not_a_number_is_a_breakdown(many_lanes: None) -> None:
    system, _ = contact_system(1)
    values = system.values.numpy()
    values[0, system.pattern.diagonal[7], 0, 0] = np.nan
    system.values.assign(values)
    report = factorise(system, 1)
    assert report.breakdown.tolist() == [True] and report.iterations.tolist() == [0]
    assert (system.solution.numpy() == 0).all()


@pytest.mark.parametrize("place", ["gel", "body"])
def test_negative_pivots_are_turned_and_the_solution_descends(many_lanes: None, place: str) -> None:
    """Where the gel is not positive definite, or the Schur complement of the body alone."""
    system, (dense,) = contact_system(1)
    row = 7 if place == "gel" else system.pattern.free_count - 1
    # More than the body has beside what the gel takes from it.
    less = 3 * np.abs(dense[3 * row : 3 * row + 3]).sum() * np.diag([1.0, 0.1, 0.0])
    values = system.values.numpy()
    values[0, system.pattern.diagonal[row]] -= less
    system.values.assign(values)
    dense[3 * row : 3 * row + 3, 3 * row : 3 * row + 3] -= less
    assert np.linalg.eigvalsh(dense)[0] < 0
    report = factorise(system, 1)
    assert report.breakdown.tolist() == [True] and report.iterations.tolist() == [1]
    plan, _ = plan_arrow(system.pattern, system.clusters, 1024 * 227)
    order = np.concatenate([plan.order, plan.border])
    load = system.rhs.numpy().ravel()
    wanted = np.linalg.solve(turned(dense, order, len(plan.order)), load)
    found = system.solution.numpy().ravel()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9 * np.abs(wanted).max())
    assert found @ load > 0
    # No further than coupled gel nodes lie apart at rest.
    system.positions_m = 1e-3 * np.abs(wanted).max() * np.eye(system.pattern.free_count, 3)
    factorise(system, 1)
    short = system.solution.numpy().ravel()
    assert np.linalg.norm(short) < 0.01 * np.linalg.norm(wanted)
    np.testing.assert_allclose(short / np.linalg.norm(short), wanted / np.linalg.norm(wanted))


def test_every_block_gives_forward_and_back_once() -> None:
    plan = eliminate(delaunay_pattern(np.random.default_rng(0), 40, 5), np.arange(30, 34))
    program = arrow_program(plan)
    layout, words = program.layout, program.words

    def section(first: int, count: int) -> np.ndarray:
        return words[first : first + count]

    starts = section(layout.step_starts, layout.step_count + 1)
    targets = section(layout.targets, starts[-1] + 1)
    entries = section(layout.entries, targets[-1] & 0xFFFF)
    gave: dict[str, list[tuple[int, int, int]]] = {"forward": [], "back": []}
    done: dict[str, set[int]] = {"forward": set(), "back": set()}
    for step in range(layout.step_count):
        way = "forward" if step < layout.forward_steps else "back"
        takers, givers = set(), set()
        for t in range(starts[step], starts[step + 1]):
            taker = targets[t] >> 16
            for e in range(targets[t] & 0xFFFF, targets[t + 1] & 0xFFFF):
                giver = entries[e] & 0xFFFF
                pair = (taker, giver) if way == "forward" else (giver, taker)
                gave[way].append((entries[e] >> 16, *pair))
                takers.add(taker)
                givers.add(giver)
        # Nobody takes who gives in this step, or gave before.
        assert not takers & (givers | done[way])
        done[way] |= givers
    blocks, rows = plan.inner.T
    expected = sorted(zip(blocks, rows, plan.columns[blocks], strict=True))
    assert sorted(gave["forward"]) == sorted(gave["back"]) == expected


@pytest.mark.thorough
def test_the_smallest_memory_that_holds_a_factor_is_taken() -> None:
    """For every chip; where all of it is too long, its lists stay in global memory first."""
    sizes, touching = (
        (25, 35, 50, 65, 68, 80, 120),
        [contact_system(1, bodies=n)[0] for n in (1, 2)],
    )
    cases = [(delaunay_pattern(np.random.default_rng(1), n, 10), []) for n in sizes]
    taken = set()
    for pattern, clusters in [*cases, *((system.pattern, system.clusters) for system in touching)]:
        for limit in (0, *(1024 * kib for kib in ROOMS_KIB)):
            program = plan_arrow(pattern, clusters, limit)[1]
            place = program.placement(limit)
            assert place.shared_bytes <= max(limit, STATIC_BYTES)
            rooms = [r for r in ROOMS_KIB if 1024 * r <= limit and 1024 * r < place.shared_bytes]
            if place.room:
                held = program.numbers if place.words_inside else program.layout.words
                assert held <= place.room
                assert all(8 * held + STATIC_BYTES > 1024 * kib for kib in rooms)
            else:
                assert 8 * program.layout.words + STATIC_BYTES > limit
            taken.add((place.shared_bytes // 1024 if place.room else 0, place.words_inside))
    assert taken >= {(kib, True) for kib in ROOMS_KIB} | {(99, False), (163, False), (0, False)}


@pytest.mark.parametrize(
    ("chip", "kib", "expected"),
    [
        ("RTX 4090", 99, "global memory"),
        ("A100", 163, "163 KiB of shared memory, its lists in global memory"),
        ("H100", 227, "227 KiB of shared memory"),
    ],
)
def test_a_gel_and_two_bodies_on_each_chip(chip: str, kib: int, expected: str) -> None:
    case = contact_system(1, bodies=2)[0]
    place = plan_arrow(case.pattern, case.clusters, 1024 * kib)[1].placement(1024 * kib)
    assert str(place) == expected, chip


def test_two_blocks_share_a_multiprocessor_if_their_numbers_fit() -> None:
    limit = 1024 * 227
    texts = []
    for count in (1, 2):
        case = contact_system(1, bodies=count)[0]
        program = plan_arrow(case.pattern, case.clusters, limit)[1]
        places = program.placement(limit), program.placement(limit, beside=True)
        assert 2 * (places[1].shared_bytes + 1024) <= limit + 1024 or places[0] == places[1]
        texts.append([str(place) for place in places])
    small, large = texts
    assert small[0] == "163 KiB of shared memory"
    assert small[1] == "99 KiB of shared memory, its lists in global memory"
    assert large == 2 * ["227 KiB of shared memory"]


def test_more_rows_than_it_is_for_are_refused() -> None:
    pattern = delaunay_pattern(np.random.default_rng(1), 900, 10)
    with pytest.raises(InputError, match=r"up to 400 rows.*has 890; use another, such as cg"):
        Arrow(LinearSystem(pattern, 1, CPU, method="cg"), [])


@pytest.mark.thorough
def test_a_program_knows_what_it_can_number() -> None:
    """A chain that touches a border of 240 rows: half a word holds no number of its last blocks."""
    chain = np.stack([np.arange(299), np.arange(1, 300)], axis=1)
    border = 300 + np.arange(240)
    pattern = block_pattern([chain, border[:, None]], np.arange(540))
    assert not arrow_program(eliminate(pattern, border)).addressable
    assert arrow_program(eliminate(pattern, border[:150])).addressable
