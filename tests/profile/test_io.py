# SPDX-License-Identifier: Apache-2.0
"""Profile folders: round trips, and everything that can be wrong with one."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
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

MESH = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")
# The folder fixtures are rebuilt or left unchanged by every example.
reuse_fixtures = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def arrays_of(profile: SensorProfile) -> dict[str, np.ndarray]:
    found = {name: getattr(profile.mesh, name) for name in MESH} | dict(profile.color_weights or {})
    if profile.background_rgb is not None:
        found["background_rgb"] = profile.background_rgb
    return found


def assert_same(left: SensorProfile, right: SensorProfile) -> None:
    assert left.blocks() == right.blocks()
    assert (left.color_weights is None) == (right.color_weights is None)
    one, other = arrays_of(left), arrays_of(right)
    assert set(one) == set(other)
    for name, array in one.items():
        assert array.dtype == other[name].dtype
        np.testing.assert_array_equal(array, other[name])


def test_round_trip(full_profile: SensorProfile, profile_folder: Path) -> None:
    assert_same(load_profile(profile_folder), full_profile)
    assert validate_profile(profile_folder) == []
    again = profile_folder.with_name("again")
    save_profile(load_profile(profile_folder), again)
    for path in profile_folder.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes()
    # A profile of fewer blocks replaces it.
    bare = full_profile.without(*OPTIONAL_BLOCKS)
    save_profile(bare, profile_folder)
    assert sorted(p.name for p in profile_folder.iterdir()) == ["mesh.npz", "profile.toml"]
    assert_same(load_profile(profile_folder), bare)
    assert validate_profile(profile_folder) == []


printable = st.text(st.characters(exclude_categories=("C",)), min_size=1, max_size=30)
texts = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=60)
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | texts
scalars |= st.floats(allow_nan=False, allow_infinity=False)
config = st.dictionaries(printable, scalars | st.lists(scalars, max_size=4), max_size=4)
finite = st.floats(-1, 1)
pairs = st.tuples(finite, finite).map(lambda pair: tuple(sorted(pair)))
provenances = st.builds(
    Provenance,
    kind=st.sampled_from(["assumed", "published", "designed", "measured"]),
    method=texts,
    source=texts,
    inputs=st.dictionaries(printable, st.from_regex(r"[0-9a-f]{64}", fullmatch=True), max_size=3),
    residuals=st.dictionaries(printable, finite, max_size=3),
    spread=st.dictionaries(printable, finite.map(abs), max_size=2),
    valid_region=st.dictionaries(printable, pairs, max_size=2),
)


@pytest.mark.thorough
@settings(reuse_fixtures, max_examples=30)
@given(data=st.data())
def test_round_trip_of_random_values(
    full_profile: SensorProfile, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    assert full_profile.background is not None and full_profile.color is not None
    draw, rng = data.draw, np.random.default_rng(data.draw(st.integers(0, 2**32)))
    material = full_profile.material.replace(
        young_modulus_pa=draw(st.floats(2e3, 5e7)), provenance=draw(provenances)
    )
    sensor = full_profile.sensor.replace(
        name=draw(printable), parameters=draw(config), provenance=draw(provenances)
    )
    levels = draw(hnp.arrays(np.float32, (9, 12, 3), elements=st.floats(0, 255, width=32)))
    hidden, activation = draw(st.integers(1, 5)), draw(st.sampled_from(sorted(ACTIVATIONS)))
    color = ColorModelConfig(
        12, 9, hidden=(hidden,), activation=activation, output_scale=60.0, position_bands=2
    )
    kind = draw(st.sampled_from([np.float32, np.float64]))
    shapes = color.weight_shapes().items()
    weights = {name: rng.normal(0, 0.4, shape).astype(kind) for name, shape in shapes}
    profile = full_profile.with_block(sensor).with_block(material)
    profile = profile.with_block(full_profile.background, levels)
    architecture = full_profile.color.replace(architecture=color.to_dict())
    profile = profile.with_block(architecture, weights)
    folder = tmp_path_factory.mktemp("random") / "profile"
    save_profile(profile, folder)
    assert_same(load_profile(folder), profile)


@reuse_fixtures
@given(
    st.sampled_from(["mesh.npz", "background.npz", "color_model.safetensors"]),
    st.floats(0, 1, exclude_max=True),
    st.integers(1, 255),
)
def test_any_changed_byte_is_seen(profile_folder: Path, name: str, where: float, flip: int) -> None:
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


SAID = {"kind": "assumed", "method": "m", "source": "s"}
BRANCH = {"relative_modulus": 0.1, "time_s": 1.0}


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
            {"material": {"branches": [{**BRANCH, "relative_modulus": 0.0}]}},
            r"material\.branches\.0\.relative_modulus: must lie in",
        ),
        ({"material": {"branches": [BRANCH] * 4}}, r"material\.branches: .*at most 3"),
        ({"material": {"layers": []}}, "tets of layer 1, but material.layers states 0"),
        ({"gel": {"colour": "red"}}, r"gel\.colour: unknown key"),
        ({"gel": {"file": "../mesh.npz"}}, r"gel\.file: .*mesh\.npz"),
        ({"gel": {"thickness_mm": 0}}, r"gel\.thickness_mm: must lie in"),
        ({"gel": {"node_count": 7}}, "node_count is 7 but the mesh has 5"),
        ({"gel": {"provenance": {**SAID, "created": 5}}}, r"created: .*valid datetime \(found 5\)"),
        ({"material": {"poisson_ratio": 0.5}}, r"material\.poisson_ratio: must be below 0\.5"),
        ({"material": {"young_modulus_pa": "2e5"}}, r"toml: material.young_mod.* \(found '2e5'\)"),
        ({"material": {"young_modulus_pa": True}}, r"toml: material.young_mod.* \(found True\)"),
        ({"camera": {"width_px": True}}, r"camera.width_px: .*valid integer \(found True\)"),
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


@pytest.mark.parametrize(
    ("file", "arrays", "words"),
    [
        ("background", {"image": np.zeros(3)}, r"must hold the arrays \['rgb'\]"),
        ("background", {"rgb": np.array([{"a": 1}], dtype=object)}, r"is not a readable \.npz"),
        (
            "mesh",
            {"faces": lambda v: np.tile(v[:1], (len(v), 1))},
            ".*0 are not out.* and 5 are repeated",
        ),
        ("mesh", {"tets": lambda v: v.astype(np.int64) + 2**32}, ".*tets must hold whole numbers"),
        ("mesh", {"face_regions": lambda v: v + 1}, r".*holds 1 to 4; allowed: 0 \(side\), 1 \(co"),
        ("mesh", {"nodes_m": lambda v: np.where(v == v.max(), np.nan, v)}, ".*NaN"),
    ],
)
def test_arrays_that_are_none_of_a_profile(
    file: str,
    arrays: dict[str, Any],
    words: str,
    profile_folder: Path,
    full_profile: SensorProfile,
) -> None:
    if file == "mesh":
        mesh = {name: getattr(full_profile.mesh, name) for name in MESH}
        arrays = mesh | {name: change(mesh[name]) for name, change in arrays.items()}
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    rehash(profile_folder, f"{file}.npz", stream.getvalue())
    with pytest.raises(InputError, match=rf"{file}\.npz: {words}"):
        load_profile(profile_folder)


def test_folders_of_other_things(full_profile: SensorProfile, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "bytes").mkdir()
    (tmp_path / "bytes" / "profile.toml").write_bytes(b"\xff\xfe")
    for name, words in (
        ("absent", "no such profile folder"),
        ("", "no such file; a profile is a folder"),
        ("file", "is not a folder"),
        ("bytes", "UTF-8"),
    ):
        with pytest.raises(InputError, match=words):
            load_profile(tmp_path / name)
    with pytest.raises(InputError, match=r"not part of a profile \(bytes, file\)"):
        save_profile(full_profile, tmp_path)
    assert (tmp_path / "file").read_text() == "x"


def test_all_findings_come_at_once(profile_folder: Path) -> None:
    edit(profile_folder, material={"poisson_ratio": 0.5}, camera={"width_px": 1})
    (profile_folder / "mesh.npz").write_bytes(b"")
    (profile_folder / "notes.txt").write_text("mine")
    findings = validate_profile(profile_folder)
    text = "\n".join(map(str, findings))
    for expected in ("poisson_ratio", "width_px", "mesh.npz: SHA-256"):
        assert expected in text
    assert [f.severity for f in findings if f.where.endswith("notes.txt")] == ["warning"]


def test_a_failed_save_leaves_the_old_profile(
    full_profile: SensorProfile, profile_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = full_profile.with_block(full_profile.material.replace(poisson_ratio=0.1))
    write_text = Path.write_text

    def fail(self: Path, *args: Any, **kwargs: Any) -> int:
        write_text(self, "half")
        raise OSError("no space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", fail)
        with pytest.raises(OSError, match="no space"):
            save_profile(changed, profile_folder)
    assert_same(load_profile(profile_folder), full_profile)
    assert [entry.name for entry in profile_folder.parent.iterdir()] == [profile_folder.name]


def test_what_a_material_was_fitted_to_is_kept(full_profile: SensorProfile, tmp_path: Path) -> None:
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
