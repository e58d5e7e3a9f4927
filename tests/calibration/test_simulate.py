# SPDX-License-Identifier: Apache-2.0
"""Presses simulated until the contact has the radius of the capture's circle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import taccel_lab.calibration.simulate as simulate
from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.simulate import simulate_presses
from taccel_lab.calibration.surfaces import PressSurface, press_batch
from taccel_lab.calibration.surfaces.depth_search import MAX_ROUNDS, DepthSearch
from taccel_lab.calibration.surfaces.press_batch import BatchOutcome, PressBatch
from taccel_lab.calibration.surfaces.shared_law import SPANNING, spanning_presses
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.files.file_cache import CACHE_VARIABLE
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses.physics import PHYSICS, SURFACE_PHYSICS, Accuracy
from taccel_lab.profile import SensorProfile
from taccel_lab.scene import Element
from taccel_lab.sensors.profile import catalogue_profile
from tests.support.synthetic_presses import memory_captures

BALL_MM = 2.0
TOLERANCE_MM = 0.007
GRID = PixelGrid(96, 72, 0.1, 0.1)
DEFAULT = SURFACE_PHYSICS
QUICK = replace(DEFAULT, element=Element.LINEAR)
"""For what does not depend on how good the forces are: which presses are simulated, in which order,
in which process, and what is kept of them."""
# Contacts of 0.8, 1.2 and 1.0 mm at places where the dome leans.
CIRCLES = (
    ContactCircle(30.0, 40.0, 8.0),
    ContactCircle(60.0, 30.0, 12.0),
    ContactCircle(47.5, 35.5, 10.0),
)

Law = Callable[[np.ndarray], np.ndarray]


def search(targets_mm: np.ndarray, law: Law) -> tuple[DepthSearch, int]:
    """Let the search run on an analytic radius(depth); returns it and its rounds."""
    found = DepthSearch(targets_mm, BALL_MM, TOLERANCE_MM)
    for rounds in range(1, MAX_ROUNDS + 1):
        assert (found.depth_mm >= 0).all() and (found.depth_mm <= 1.2 * BALL_MM).all()
        if found.update(law(found.depth_mm)):
            return found, rounds
    raise AssertionError("the search did not end")


@given(
    scale=st.floats(0.75, 1.25),
    power=st.floats(0.42, 0.58),
    targets=st.lists(st.floats(0.3, 1.5), min_size=1, max_size=6),
)
def test_search_on_smooth_laws(scale: float, power: float, targets: list[float]) -> None:
    """Contact radii from Hertz (1.0 R sqrt(d / R)) to the cap (1.41 R sqrt(d / R)) and beyond."""
    wanted = np.array(targets)

    def law(depth: np.ndarray) -> np.ndarray:
        return scale * 1.1 * BALL_MM * (depth / BALL_MM) ** power

    found, _ = search(wanted, law)
    assert np.abs(law(found.depth_mm) - wanted).max() <= TOLERANCE_MM
    assert np.array_equal(found.radius_mm, law(found.depth_mm))


def test_search_needs_few_rounds_on_the_cap_like_law_it_starts_from() -> None:
    def law(depth: np.ndarray) -> np.ndarray:
        cap = np.clip(depth / 1.5, 0, BALL_MM)
        return np.sqrt(2 * BALL_MM * cap - cap**2)

    _, rounds = search(np.array([0.5, 0.9, 1.3]), law)
    assert rounds <= 3


@pytest.mark.parametrize(
    ("noise_mm", "p90_mm", "worst_mm"), [(0.003, 0.008, 0.015), (0.01, 0.013, 0.04)]
)
def test_search_with_noise_comes_as_near_as_the_noise_lets_it(
    noise_mm: float, p90_mm: float, worst_mm: float
) -> None:
    """Measured radii carry noise; secants over small steps would send the search astray."""

    def true_radius(depth: np.ndarray) -> np.ndarray:
        return 1.05 * np.sqrt(BALL_MM * depth)

    errors = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        wanted = rng.uniform(0.3, 1.5, 3)
        found, _ = search(
            wanted, lambda d, rng=rng: true_radius(d) + rng.uniform(-noise_mm, noise_mm, d.shape)
        )
        errors.append(np.abs(true_radius(found.depth_mm) - wanted).max())
    assert np.percentile(errors, 90) < p90_mm
    assert max(errors) < worst_mm


def test_search_of_a_contact_that_stops_growing() -> None:
    """A circle larger than the gel can close around the ball: stop at the limit, unmet."""

    def law(depth: np.ndarray) -> np.ndarray:
        return np.minimum(1.1 * np.sqrt(BALL_MM * depth), 1.7)

    found, rounds = search(np.array([1.9, 0.8]), law)
    assert rounds == MAX_ROUNDS
    assert found.depth_mm[0] == pytest.approx(1.2 * BALL_MM)
    assert found.radius_mm[0] == pytest.approx(1.7)
    assert law(found.depth_mm)[1] == pytest.approx(0.8, abs=TOLERANCE_MM)


def test_search_leaves_alone_what_is_met() -> None:
    depths: list[np.ndarray] = []

    def law(depth: np.ndarray) -> np.ndarray:
        depths.append(depth.copy())
        return np.array([0.5, 0.9 * np.sqrt(BALL_MM * depth[1])])

    search(np.array([0.5, 1.2]), law)
    assert len({float(d[0]) for d in depths}) == 1
    assert len({float(d[1]) for d in depths}) > 1


@pytest.fixture(scope="module")
def profile() -> SensorProfile:
    return catalogue_profile("gelsight")


def flat_captures(sensor: str, circles: tuple[ContactCircle, ...]) -> CaptureSet:
    """Black images: simulations look at circles, scale and ball alone."""
    black = np.zeros((GRID.height_px, GRID.width_px, 3), dtype=np.uint8)
    return memory_captures(circles, [black] * len(circles), black, GRID, BALL_MM, sensor)


@pytest.fixture(scope="module")
def captures() -> CaptureSet:
    return flat_captures("gelsight", CIRCLES)


@pytest.fixture(scope="module")
def base(profile: SensorProfile, captures: CaptureSet) -> SensorProfile:
    return on_grid(profile, captures.grid, captures.provenance)


@pytest.fixture(scope="module")
def quick(captures: CaptureSet, base: SensorProfile) -> list[PressSurface]:
    return simulate_presses(captures, CIRCLES, base, physics=QUICK, processes=1)


@pytest.fixture(scope="module")
def surfaces(captures: CaptureSet, base: SensorProfile) -> list[PressSurface]:
    return simulate_presses(captures, CIRCLES, base, physics=DEFAULT, processes=1)


def test_contact_meets_the_circle(surfaces: list[PressSurface]) -> None:
    assert len(surfaces) == len(CIRCLES)
    for circle, surface in zip(CIRCLES, surfaces, strict=True):
        assert surface.contact_radius_px == pytest.approx(circle.radius_px, abs=0.3)
        assert surface.force_n > 0
        assert surface.residual_n < 1e-4 * 3 * surface.force_n
        effort = surface.effort
        assert effort is not None
        assert effort.step_count >= 1 and effort.newton_iterations >= effort.step_count
        assert 0 < effort.min_distance_m < 2e-5
    # A larger contact is deeper and takes more force: 0.8, 1.2, 1.0 mm.
    depths = [s.depth_mm for s in surfaces]
    forces = [s.force_n for s in surfaces]
    assert depths[0] < depths[2] < depths[1] and forces[0] < forces[2] < forces[1]
    for circle, depth in zip(CIRCLES, depths, strict=True):
        radius_mm = circle.radius_px * GRID.mm_per_px_x
        cap = BALL_MM - np.sqrt(BALL_MM**2 - radius_mm**2)
        assert cap < depth < 2.2 * cap


def test_surfaces_lie_under_their_circles(surfaces: list[PressSurface]) -> None:
    for circle, surface in zip(CIRCLES, surfaces, strict=True):
        sunk = surface.displacement_mm()
        assert sunk.shape == (GRID.height_px, GRID.width_px)
        assert np.isfinite(sunk).all() and np.isfinite(surface.normals).all()
        away = circle.distance_px(GRID)
        v, u = np.unravel_index(np.argmin(sunk), sunk.shape)
        assert np.hypot(u - circle.u_px, v - circle.v_px) < 2.0
        # The gel keeps a gap below dhat to the ball, and no pixel lies just below its lowest point.
        assert -0.02 < sunk.min() + surface.depth_mm < 0.003
        # The gel sinks beside the contact too, less and less.
        ring = [sunk[np.abs(away - r * circle.radius_px) < 1].mean() for r in (1.2, 1.6, 2.2)]
        assert ring[0] < ring[1] < ring[2] and ring[0] < -0.01
        # Within the contact the surface is the ball's: slope r / sqrt(R^2 - r^2) to its centre.
        x_mm = (np.arange(GRID.width_px) - circle.u_px) * GRID.mm_per_px_x
        row = round(circle.v_px)
        inside = np.abs(x_mm) < 0.7 * circle.radius_px * GRID.mm_per_px_x
        expected = -x_mm[inside] / BALL_MM
        assert surface.normals[row, inside, 0] == pytest.approx(expected, abs=0.05)


def test_in_contact_the_surface_is_the_ball_without_bumps(surfaces: list[PressSurface]) -> None:
    """Nodes of quadratic faces hover at heights of their own within the barrier's range: a surface
    through them is off by more than a degree here, and by three under deeper presses."""
    for circle, surface in zip(CIRCLES, surfaces, strict=True):
        x_mm = (np.arange(GRID.width_px)[None, :] - circle.u_px) * GRID.mm_per_px_x
        y_mm = (np.arange(GRID.height_px)[:, None] - circle.v_px) * GRID.mm_per_px_y
        away = circle.distance_px(GRID)
        below = np.sqrt(np.maximum(BALL_MM**2 - x_mm**2 - y_mm**2, 0.0))
        ball = np.stack([-x_mm + 0 * below, -y_mm + 0 * below, below], axis=-1) / BALL_MM
        inside = away < 0.8 * circle.radius_px
        cosine = (surface.normals * ball).sum(axis=-1)[inside]
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.7


def test_friction_is_named_and_matters(
    captures: CaptureSet, base: SensorProfile, quick: list[PressSurface]
) -> None:
    one = replace(captures, presses=captures.presses[:1])
    (rough,) = simulate_presses(
        one, CIRCLES[:1], base, physics=QUICK, friction_coefficient=0.8, processes=1
    )
    assert rough.provider == "finite elements, friction 0.8"
    assert quick[0].provider == "finite elements, friction 0"
    assert rough.force_n > 1.01 * quick[0].force_n


def test_order_and_progress_with_several_processes(
    captures: CaptureSet,
    base: SensorProfile,
    quick: list[PressSurface],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(simulate, "BATCH", 2)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    results = {}
    for processes in (1, 2):
        told: list[tuple[int, int]] = []
        results[processes] = simulate_presses(
            captures,
            CIRCLES,
            base,
            physics=QUICK,
            processes=processes,
            progress=lambda _, done, total, told=told: told.append((done, total)),
        )
        assert told[-1] == (3, 3) and len(told) == 2
        assert [done for done, _ in told] == sorted(done for done, _ in told)
    for one, two, alone in zip(results[1], results[2], quick, strict=True):
        assert np.array_equal(one.height_m, two.height_m)
        assert np.array_equal(one.normals, two.normals)
        assert (one.depth_mm, one.force_n) == (two.depth_mm, two.force_n)
        # Batched otherwise, the search goes other ways to the same circle.
        assert one.contact_radius_px == pytest.approx(alone.contact_radius_px, abs=0.6)
        assert one.depth_mm == pytest.approx(alone.depth_mm, rel=0.06)


def test_what_no_ball_or_pad_can_show_is_refused(captures: CaptureSet, base: SensorProfile) -> None:
    large = [CIRCLES[0], ContactCircle(48.0, 36.0, 21.0), CIRCLES[2]]
    wide = replace(captures, grid=PixelGrid(96, 72, 0.28, 0.28), ball_radius_mm=5.0)
    for seen, circles, words in (
        (captures, large, r"memory: p1: contact radius 21 px is 2\.100 mm"),
        (wide, CIRCLES, r"memory: .* shows 26\.9 x 20\.2 mm, more than the pad"),
        (captures, CIRCLES[:2], "2 contact circles for 3 presses"),
    ):
        with pytest.raises(InputError, match=words):
            simulate_presses(seen, circles, base, physics=DEFAULT, processes=1)


def test_a_press_to_the_equator(captures: CaptureSet, base: SensorProfile) -> None:
    """A circle as large as the ball, or larger by a pixel: what is seen ends at the equator."""
    one = replace(captures, presses=captures.presses[:1])
    (surface,) = simulate_presses(one, [ContactCircle(47.5, 35.5, 20.3)], base, processes=1)
    assert 18.5 < surface.contact_radius_px <= 20.0
    assert BALL_MM < surface.depth_mm <= 1.2 * BALL_MM
    assert np.isfinite(surface.normals).all()
    steepest = np.degrees(np.arccos(surface.normals[..., 2].min()))
    assert 60 < steepest < 90


def test_kept_presses_are_bitwise_those_that_were_simulated(
    captures: CaptureSet,
    base: SensorProfile,
    quick: list[PressSurface],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    first = simulate_presses(captures, CIRCLES, base, physics=QUICK, processes=1, cache=True)
    (kept,) = (tmp_path / "presses").iterdir()
    monkeypatch.setattr(simulate, "simulate_batch", fail)
    again = simulate_presses(captures, CIRCLES, base, physics=QUICK, processes=1, cache=True)
    for one, two, three in zip(quick, first, again, strict=True):
        for name in ("height_m", "normals", "rest_height_m", "rest_normals"):
            assert np.array_equal(getattr(one, name), getattr(two, name))
            assert np.array_equal(getattr(two, name), getattr(three, name))
        assert (one.depth_mm, one.force_n) == (three.depth_mm, three.force_n)
    # Anything else that matters asks for a simulation of its own.
    stiffer = base.material.model_copy(update={"young_modulus_pa": 9e5})
    for other, circles, physics in (
        (replace(base, material=stiffer), CIRCLES, QUICK),
        (base, (CIRCLES[1], *CIRCLES[1:]), QUICK),
        (base, CIRCLES, PHYSICS[Accuracy.FAST]),
    ):
        with pytest.raises(SimulationError, match="made up"):
            simulate_presses(captures, circles, other, physics=physics, processes=1, cache=True)
    kept.write_bytes(kept.read_bytes()[:100])
    with (
        pytest.warns(UserWarning, match="are damaged"),
        pytest.raises(SimulationError, match="made up"),
    ):
        simulate_presses(captures, CIRCLES, base, physics=QUICK, processes=1, cache=True)


def test_without_friction_one_step_ends_where_many_do(
    captures: CaptureSet, base: SensorProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = replace(captures, presses=captures.presses[:1])
    (at_once,) = simulate_presses(one, CIRCLES[:1], base, physics=QUICK, processes=1)
    monkeypatch.setattr(press_batch, "FREE_STEP_MM", 0.05)
    (slowly,) = simulate_presses(one, CIRCLES[:1], base, physics=QUICK, processes=1)
    assert at_once.effort is not None and slowly.effort is not None
    assert at_once.effort.newton_iterations < 0.6 * slowly.effort.newton_iterations
    assert np.abs(at_once.height_m - slowly.height_m).max() < 2e-6
    cosine = (at_once.normals * slowly.normals).sum(axis=-1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean() < 0.05


def many_presses(captures: CaptureSet, count: int) -> tuple[CaptureSet, list[ContactCircle]]:
    """Presses of 0.8 to 1.25 mm near the middle of the pad."""
    circles = [
        ContactCircle(40.0 + 2.0 * (i % 5), 31.0 + 3.0 * (i % 4), 8.0 + 0.5 * i)
        for i in range(count)
    ]
    presses = tuple(replace(captures.presses[0], name=f"m{i}") for i in range(count))
    return replace(captures, presses=presses), circles


def test_presses_that_are_spanned_are_not_simulated(
    captures: CaptureSet, base: SensorProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    many, circles = many_presses(captures, 10)
    simulated: list[int] = []
    real = simulate.simulate_batch

    def counted(batch: PressBatch) -> BatchOutcome:
        simulated.extend(batch.presses)
        return real(batch)

    monkeypatch.setattr(simulate, "simulate_batch", counted)
    told: list[tuple[int, int]] = []
    shared = simulate_presses(
        many, circles, base, physics=QUICK, processes=1, share=True,
        progress=lambda _, done, total: told.append((done, total)),
    )  # fmt: skip
    assert sorted(simulated) == spanning_presses(circles) and len(simulated) == SPANNING
    assert told == [(3, 10), (6, 10), (10, 10)]
    chosen = [i for i in range(10) if i not in simulated][:3]
    few = replace(many, presses=tuple(many.presses[i] for i in chosen))
    each = simulate_presses(few, [circles[i] for i in chosen], base, physics=QUICK, processes=1)
    for i, surface in zip(chosen, each, strict=True):
        near = circles[i].distance_px(GRID) <= 2.5 * circles[i].radius_px
        cosine = (shared[i].normals * surface.normals).sum(axis=-1)
        # The mesh of these tests is coarse: its facets alone make 0.8 degrees.
        assert np.degrees(np.arccos(np.clip(cosine, -1, 1)))[near].mean() < 1.5
        assert shared[i].depth_mm == pytest.approx(surface.depth_mm, rel=0.06)
        assert shared[i].provider.startswith("between 6 presses by finite elements")


def test_presses_that_follow_no_common_law_and_few_ones_are_all_simulated(
    captures: CaptureSet, base: SensorProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    many, circles = many_presses(captures, 9)
    monkeypatch.setattr(simulate.SharedLaw, "holds", property(lambda self: False))
    found = simulate_presses(many, circles, base, physics=QUICK, processes=1, share=True)
    monkeypatch.undo()  # Few presses are not spanned either.
    found += simulate_presses(captures, CIRCLES, base, physics=QUICK, processes=1, share=True)
    assert {surface.provider for surface in found} == {"finite elements, friction 0"}


def test_a_cache_that_cannot_be_written_is_named(
    captures: CaptureSet, base: SensorProfile, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "file"
    blocked.touch()
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    one = replace(captures, presses=captures.presses[:1])
    with pytest.raises(InputError, match=CACHE_VARIABLE):
        simulate_presses(one, CIRCLES[:1], base, physics=QUICK, processes=1, cache=True)


def test_a_stiff_skin_spreads_the_dent() -> None:
    """A sensor with a skin is simulated with it: the same contact takes more force."""
    forces = {}
    for skin_mpa in (0.2, 2.0):
        overrides = {"skin_young_modulus_mpa": skin_mpa}
        profile = catalogue_profile("9dtact", overrides)
        assert len(profile.material.layers) == 1
        one = flat_captures("9dtact", (ContactCircle(48.0, 36.0, 10.0),))
        (surface,) = simulate_presses(
            one, [ContactCircle(48.0, 36.0, 10.0)], profile, physics=QUICK, processes=1
        )
        forces[skin_mpa] = surface.force_n
    assert forces[2.0] > 1.2 * forces[0.2]


def fail(batch: object) -> BatchOutcome:
    raise SimulationError("made up")


def test_a_failure_in_a_worker_keeps_its_message(
    captures: CaptureSet, base: SensorProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulate, "BATCH", 2)
    with pytest.raises(InputError, match="core = 5 is odd"):
        odd = replace(QUICK, mesh=replace(QUICK.mesh, core=5))
        simulate_presses(captures, CIRCLES, base, physics=odd, processes=2)
