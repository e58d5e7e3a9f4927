# SPDX-License-Identifier: Apache-2.0
"""Profile folders: round trips, and everything that can be wrong with one."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from taccel_lab.errors import InputError
from taccel_lab.networks.color_settings import ACTIVATIONS, ColorModelConfig
from taccel_lab.profile import (
    FittedWith,
    Provenance,
    SensorProfile,
    load_profile,
    save_profile,
    validate_profile,
)
from taccel_lab.profile.sensor_view import OPTIONAL_BLOCKS
from tests.support.edited_profiles import edit, rehash

ARRAY_FILES = ("mesh.npz", "background.npz", "color_model.safetensors")

# The folder fixtures are rebuilt or left unchanged by every example.
reuse_fixtures = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def assert_same(left: SensorProfile, right: SensorProfile) -> None:
    assert left.blocks() == right.blocks()
    for name in ("nodes_m", "tets", "faces", "face_regions", "tet_layers"):
        np.testing.assert_array_equal(getattr(left.mesh, name), getattr(right.mesh, name))
    assert (left.background_rgb is None) == (right.background_rgb is None)
    if left.background_rgb is not None and right.background_rgb is not None:
        assert left.background_rgb.dtype == right.background_rgb.dtype
        np.testing.assert_array_equal(left.background_rgb, right.background_rgb)
    assert (left.color_weights is None) == (right.color_weights is None)
    if left.color_weights is not None and right.color_weights is not None:
        assert set(left.color_weights) == set(right.color_weights)
        for name, array in left.color_weights.items():
            assert array.dtype == right.color_weights[name].dtype
            np.testing.assert_array_equal(array, right.color_weights[name])


def test_round_trip(full_profile: SensorProfile, profile_folder: Path) -> None:
    assert_same(load_profile(profile_folder), full_profile)
    assert validate_profile(profile_folder) == []
    again = profile_folder.with_name("again")
    save_profile(load_profile(profile_folder), again)
    for path in profile_folder.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes()


def test_round_trip_without_optional_blocks(full_profile: SensorProfile, tmp_path: Path) -> None:
    bare = full_profile.without(*OPTIONAL_BLOCKS)
    save_profile(bare, tmp_path / "p")
    assert sorted(p.name for p in (tmp_path / "p").iterdir()) == ["mesh.npz", "profile.toml"]
    assert_same(load_profile(tmp_path / "p"), bare)


printable = st.text(st.characters(exclude_categories=("C",)), min_size=1, max_size=30)
texts = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=60)
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | texts
scalars |= st.floats(allow_nan=False, allow_infinity=False)
config = st.dictionaries(printable, scalars | st.lists(scalars, max_size=4), max_size=4)
finite = st.floats(-1, 1)
provenances = st.builds(
    Provenance,
    kind=st.sampled_from(["assumed", "published", "designed", "measured"]),
    method=texts,
    source=texts,
    inputs=st.dictionaries(printable, st.from_regex(r"[0-9a-f]{64}", fullmatch=True), max_size=3),
    residuals=st.dictionaries(printable, finite, max_size=3),
    spread=st.dictionaries(printable, finite.map(abs), max_size=2),
    valid_region=st.dictionaries(
        printable, st.tuples(finite, finite).map(lambda pair: tuple(sorted(pair))), max_size=2
    ),
)


@pytest.mark.thorough
@settings(reuse_fixtures, max_examples=30)
@given(data=st.data())
def test_round_trip_of_random_values(
    full_profile: SensorProfile, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    assert full_profile.background is not None and full_profile.color is not None
    between = lambda low, high, **kw: data.draw(st.floats(low, high, **kw))  # noqa: E731
    material = full_profile.material.replace(
        young_modulus_pa=between(2e3, 5e7),
        poisson_ratio=between(0, 0.5, exclude_max=True),
        density_kg_m3=between(100, 1e4),
        friction_coefficient=between(0, 5),
        provenance=data.draw(provenances),
    )
    sensor = full_profile.sensor.replace(
        name=data.draw(printable), parameters=data.draw(config), provenance=data.draw(provenances)
    )
    levels = hnp.arrays(np.float32, (9, 12, 3), elements=st.floats(0, 255, width=32))
    color = ColorModelConfig(
        12,
        9,
        hidden=tuple(data.draw(st.lists(st.integers(1, 5), max_size=2))),
        activation=data.draw(st.sampled_from(sorted(ACTIVATIONS))),
        output_scale=between(10, 100),
        position_bands=data.draw(st.integers(0, 2)),
    )
    kind = data.draw(st.sampled_from([np.float32, np.float64]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    weights = {
        name: rng.normal(0, 0.4, shape).astype(kind)
        for name, shape in color.weight_shapes().items()
    }
    profile = (
        full_profile.with_block(sensor)
        .with_block(material)
        .with_block(full_profile.background, data.draw(levels))
        .with_block(full_profile.color.replace(architecture=color.to_dict()), weights)
    )
    folder = tmp_path_factory.mktemp("random") / "profile"
    save_profile(profile, folder)
    assert_same(load_profile(folder), profile)


@reuse_fixtures
@given(
    name=st.sampled_from(ARRAY_FILES),
    where=st.floats(0, 1, exclude_max=True),
    flip=st.integers(1, 255),
)
def test_any_changed_byte_is_found(
    profile_folder: Path, name: str, where: float, flip: int
) -> None:
    path = profile_folder / name
    good = path.read_bytes()
    bad = bytearray(good)
    bad[int(where * len(bad))] ^= flip
    path.write_bytes(bad)
    try:
        with pytest.raises(InputError, match=rf"{name}: SHA-256"):
            load_profile(profile_folder)
    finally:
        path.write_bytes(good)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"schema_version": 99}, "newer version of taccel-lab"),
        ({"schema_version": 0}, "version 0 is not known"),
        ({"schema_version": "1"}, "must be a whole number"),
        ({"schema_version": True}, "must be a whole number"),
        ({"schema_version": None}, "must be a whole number"),
        ({"lamps": 3}, "lamps: unknown key; allowed: .*camera"),
        ({"lights": 3}, "lights: must be a table"),
        ({"lights": {"led": []}}, r"lights\.led: .*at least 1 item"),
        ({"optics": {"fx_px": -2.0}}, r"optics\..*fx_px: must lie in"),
        ({"optics": {"model": "wide"}}, r"optics\.model: .*'pinhole' or 'fisheye'"),
        ({"window": {"refractive_index": 9.0}}, r"window\..*refractive_index: must lie in"),
        ({"markers": {"radius_mm": 1.5}}, r"markers\..*radius_mm: must lie in"),
        ({"housing": {"wall_mm": 0.0}}, r"housing\.wall_mm: must lie in"),
        (
            {"material": {"branches": [{"relative_modulus": 0.0, "time_s": 1.0}]}},
            r"material\.branches\.0\.relative_modulus: must lie in",
        ),
        (
            {"material": {"branches": [{"relative_modulus": 0.1, "time_s": 1.0}] * 4}},
            r"material\.branches: .*at most 3",
        ),
        ({"material": {"layers": []}}, "tets of layer 1, but material.layers states 0"),
        ({"gel": {"colour": "red"}}, r"gel\.colour: unknown key"),
        ({"gel": {"file": "../mesh.npz"}}, r"gel\.file: .*mesh\.npz"),
        ({"gel": {"thickness_mm": 0}}, r"gel\.thickness_mm: must lie in"),
        ({"gel": {"node_count": 7}}, "node_count is 7 but the mesh has 5"),
        ({"material": {"poisson_ratio": 0.5}}, r"material\.poisson_ratio: must be below 0\.5"),
        ({"camera": {"width_px": 13}}, "camera block asks for"),
        ({"camera": None}, "camera: the table is missing"),
        ({"camera": 4}, "camera: must be a table"),
        ({"files": None}, "files: the table of file hashes is missing"),
        ({"files": {"mesh.npz": "abc"}}, r"mesh\.npz: .*lists no SHA-256"),
        ({"files": {"other.npz": "0" * 64}}, r"files\.other\.npz: no block refers"),
        ({"background": None}, r"files\.background\.npz: no block refers"),
    ],
)
def test_wrong_documents(profile_folder: Path, tables: dict[str, Any], words: str) -> None:
    edit(profile_folder, **tables)
    with pytest.raises(InputError, match=words):
        load_profile(profile_folder)
    assert any(finding.severity == "error" for finding in validate_profile(profile_folder))


def test_arrays_of_the_wrong_kind(profile_folder: Path, tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", image=np.zeros(3))
    rehash(profile_folder, "background.npz", (tmp_path / "a.npz").read_bytes())
    with pytest.raises(InputError, match=r"background\.npz: must hold the arrays \['rgb'\]"):
        load_profile(profile_folder)
    np.savez(tmp_path / "b.npz", rgb=np.array([{"a": 1}], dtype=object))
    rehash(profile_folder, "background.npz", (tmp_path / "b.npz").read_bytes())
    with pytest.raises(InputError, match=r"background\.npz: is not a readable \.npz"):
        load_profile(profile_folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"faces": lambda v: np.tile(v[:1], (len(v), 1))}, "0 are not out.* and 5 are repeated"),
        ({"tets": lambda v: v.astype(np.int64) + 2**32}, "tets must hold whole numbers that fit"),
        ({"face_regions": lambda v: v + 1}, r"holds 1 to 4; allowed: 0 \(side\), 1 \(contact\)"),
        ({"nodes_m": lambda v: np.where(v == v.max(), np.nan, v)}, "NaN"),
    ],
)
def test_a_mesh_that_is_none_is_refused(
    change: dict[str, Callable[[np.ndarray], np.ndarray]],
    words: str,
    profile_folder: Path,
    full_profile: SensorProfile,
    tmp_path: Path,
) -> None:
    names = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")
    arrays = {name: getattr(full_profile.mesh, name) for name in names}
    np.savez(tmp_path / "m.npz", **arrays | {k: f(arrays[k]) for k, f in change.items()})
    rehash(profile_folder, "mesh.npz", (tmp_path / "m.npz").read_bytes())
    with pytest.raises(InputError, match=rf"mesh\.npz: .*{words}"):
        load_profile(profile_folder)


def test_not_a_profile(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path / "absent", "no such profile folder"),
        (tmp_path, "no such file; a profile is a folder"),
    ):
        with pytest.raises(InputError, match=words):
            load_profile(path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is not a folder"):
        load_profile(tmp_path / "file")
    (tmp_path / "profile.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="UTF-8"):
        load_profile(tmp_path)


@pytest.mark.parametrize(
    ("table", "key", "value", "words"),
    [
        ("material", "young_modulus_pa", "2e5", "input should be a valid number (found '2e5')"),
        ("material", "young_modulus_pa", True, "input should be a valid number (found True)"),
        ("camera", "width_px", True, "input should be a valid integer (found True)"),
        ("provenance", "created", 5, "input should be a valid datetime (found 5)"),
    ],
)
def test_values_of_another_kind(
    profile_folder: Path, table: str, key: str, value: Any, words: str
) -> None:
    if table == "provenance":
        path = profile_folder / "profile.toml"
        document = tomllib.loads(path.read_text())
        document["gel"]["provenance"][key] = value
        path.write_text(tomli_w.dumps(document))
        table = "gel.provenance"
    else:
        edit(profile_folder, **{table: {key: value}})
    (finding,) = map(str, validate_profile(profile_folder))
    assert finding.startswith(f"{profile_folder / 'profile.toml'}: {table}.{key}: {words}")


def test_all_findings_come_at_once(profile_folder: Path) -> None:
    edit(profile_folder, material={"poisson_ratio": 0.5}, camera={"width_px": 1})
    (profile_folder / "mesh.npz").write_bytes(b"")
    (profile_folder / "notes.txt").write_text("mine")
    findings = validate_profile(profile_folder)
    text = "\n".join(map(str, findings))
    for expected in ("poisson_ratio", "width_px", "mesh.npz: SHA-256"):
        assert expected in text
    assert [f.severity for f in findings if f.where.endswith("notes.txt")] == ["warning"]


def test_saving_refuses_a_folder_of_other_things(
    full_profile: SensorProfile, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(InputError, match=r"not part of a profile \(thesis\.tex\)"):
        save_profile(full_profile, tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "mine"


def test_a_failed_save_leaves_the_old_profile(
    full_profile: SensorProfile, profile_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = full_profile.with_block(full_profile.material.replace(poisson_ratio=0.1))
    write_text = Path.write_text

    def fail(self: Path, *args: Any, **kwargs: Any) -> int:
        write_text(self, "half")
        raise OSError("no space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="no space"):
        save_profile(changed, profile_folder)
    monkeypatch.undo()
    assert_same(load_profile(profile_folder), full_profile)
    assert [entry.name for entry in profile_folder.parent.iterdir()] == [profile_folder.name]


def test_saving_replaces_an_old_profile(full_profile: SensorProfile, profile_folder: Path) -> None:
    bare = full_profile.without("background", "color")
    save_profile(bare, profile_folder)
    assert_same(load_profile(profile_folder), bare)
    assert validate_profile(profile_folder) == []


def test_what_a_material_was_fitted_with_is_kept(
    full_profile: SensorProfile, tmp_path: Path
) -> None:
    fitted = FittedWith(
        physics={"accuracy": "default", "dhat_m": 1e-5, "mesh": {"rings": 10, "fine_radii": 1.9}},
        friction_coefficient=0.3,
        friction_measured=True,
        indenters=("sphere:7.5",),
        touch_shift_mm={"press.csv": -0.02},
    )
    block = full_profile.material.replace(fitted_with=fitted)
    save_profile(full_profile.with_block(block), tmp_path / "p")
    assert load_profile(tmp_path / "p").material.fitted_with == fitted
    with pytest.raises(InputError, match="friction_coefficient"):
        block.replace(fitted_with={**fitted.model_dump(), "friction_coefficient": -1.0})
