# SPDX-License-Identifier: Apache-2.0
"""What is read is what was simulated, alone, together and through torch."""

from __future__ import annotations

import json
import pickle
import re
import resource
import shutil
from pathlib import Path
from typing import Any

import numcodecs
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from taccel_lab.datasets.channels import OPTIONAL
from taccel_lab.datasets.check import check_dataset
from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.sensor import profile_digest
from taccel_lab.datasets.torch_dataset import TouchDataset
from taccel_lab.errors import InputError
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from tests.support.small_data_sets import SIZE, make
from tests.support.strangers import Payload, lure


@pytest.mark.thorough
def test_a_touch_is_drawn(made: Path) -> None:
    data = Dataset(made)
    figure = data.plot(1)
    rows = data.rows_of(1)
    normal = figure.axes[-1].lines[0]
    assert normal.get_ydata() == pytest.approx(data.steps["press_force_z_n"][rows])
    last = [axes for axes in figure.axes if axes.images][-1].images[0]
    deepest = data.read("depth_mm", rows[-1:])[0]
    assert np.asarray(last.get_array()) == pytest.approx(deepest)
    with pytest.raises(InputError, match=f"no episode 99; 0 to {len(data.episodes) - 1}"):
        data.plot(99)


def test_labels_agree_with_one_another(made: Path) -> None:
    data = Dataset(made)
    wrench, patches, area, mask, depth, rgb = (
        data.read(name, slice(None))
        for name in (
            "wrench", "patch_forces_n", "contact_area_mm2", "contact_mask", "depth_mm", "rgb",
        )
    )  # fmt: skip
    assert patches.shape[1:] == (6, 8, 3)
    assert patches.sum(axis=(1, 2)) == pytest.approx(wrench[:, :3], abs=1e-6)
    untouched = data.steps["step"] == 0
    assert (wrench[untouched] == 0).all() and (wrench[~untouched, 2] > 0).all()
    assert data.steps["force_z_n"] == pytest.approx(wrench[:, 2])
    grid = data.profile(0).grid()
    pixel_mm2 = grid.mm_per_px_x * grid.mm_per_px_y
    assert (area[untouched] == 0).all() and (area[~untouched] > 0).all()
    assert mask.sum(axis=(1, 2)) * pixel_mm2 == pytest.approx(area, abs=3 * pixel_mm2)
    assert depth[untouched].max() == 0
    for row in np.flatnonzero(~untouched):
        # The middle of a ball's force lies in the middle of its contact.
        v, u = np.nonzero(mask[row])
        middle = grid.gel_from_pixel(np.array([u.mean(), v.mean()]))
        center = [data.steps[f"contact_center_{axis}_mm"][row] for axis in "xy"]
        assert center == pytest.approx(middle, abs=1.0)
        assert depth[row].max() == pytest.approx(data.steps["depth_mm"][row], abs=0.05)
    # A profile's image where nothing touches; another one where something does.
    background = data.profile(0).background_rgb
    assert background is not None
    assert (rgb[untouched] == np.rint(background)).all()
    assert (np.abs(rgb[~untouched].astype(int) - rgb[0]).max(axis=(1, 2, 3)) > 0).all()
    # What slides uses all of its friction, what is pressed next to nothing.
    use = data.steps["friction_use"]
    assert use.max() <= 1 + 2e-3
    slid = [data.rows_of(k)[-1] for k, row in enumerate(data.episodes) if row["motion"] == "slip"]
    assert len(slid) and (use[slid] > 0.2).all()


def test_rows_in_any_order(made: Path) -> None:
    data = Dataset(made)
    whole = data.read("rgb", slice(None))
    order = np.random.default_rng(0).permutation(len(data))
    assert (data.read("rgb", order) == whole[order]).all()
    assert (data.read("rgb", [3]) == whole[3:4]).all()
    steps = data.steps
    for place, row in enumerate(data.episodes):
        rows = data.rows_of(place)
        assert len(rows) == row["rows"] == row["steps_wanted"] + 1
        assert steps["step"][rows].tolist() == list(range(len(rows)))
        assert set(data.read("episode", rows).tolist()) == {row["episode"]}
    with pytest.raises(InputError, match="no channel 'heat'"):
        data.read("heat", [0])
    with pytest.raises(InputError, match="holds no data set"):
        Dataset(made.parent)


@pytest.mark.thorough
def test_every_channel_can_be_asked_for(profile: Path, tmp_path: Path) -> None:
    """All of the table and all signals of the gel's surface, with drawn units; nodal
    channels add up to the wrench."""
    make(
        profile, tmp_path / "all",
        dataset={"episodes": 2},
        sensors=[{"profile": str(profile), "units": 3}],
        randomise={
            "friction": [0.2, 0.6], "young_modulus_factor": [0.8, 1.2], "light_gain": 0.1,
            "image_noise_levels": 1.0, "marker_noise_px": 0.1,
        },
        motions=[{"kind": "twist", "depth_mm": [0.1, 0.2], "twist_deg": [2, 4]},
                 {"kind": "roll", "depth_mm": [0.1, 0.2], "roll_deg": [2, 4]}],
        objects=[{"tool": "sphere:3", "tilt_deg": [3, 6]}],
        output={"channels": [*OPTIONAL, "rgb_levels", "height_m", *CONTACT_SIGNALS],
                "size_px": [40, 30]},
    )  # fmt: skip
    data = Dataset(tmp_path / "all")
    assert data.read("rgb", [0, 1]).shape == (2, 30, 40, 3)
    for place in range(2):
        rows = data.rows_of(place)
        nodes, faces = data.mesh(place)
        assert faces.max() == len(nodes) - 1
        forces, total = data.read("node_forces_n", rows), data.read("wrench", rows)[:, :3]
        assert forces.sum(axis=1) == pytest.approx(total, abs=1e-5)
        touched = data.read("contact", rows)
        assert touched.dtype == np.uint8 and not touched[0].any() and touched[-1].any()
        assert not np.nan_to_num(data.read("pressure_pa", rows[:1])).any()
        assert np.nanmax(data.read("pressure_pa", rows[-1:])) > 1e3
    assert not [f for f in check_dataset([tmp_path / "all"]) if f.severity == "error"]
    # One answer to what touches: area, mask and the pixels' contact.
    mask = data.read("contact_mask", slice(None))
    assert (mask == data.read("contact", slice(None))).all()
    assert ((data.read("contact_area_mm2", slice(None)) > 0) >= mask.any(axis=(1, 2))).all()


def test_splits_are_held_apart_and_batched_by_torch(made: Path) -> None:
    from torch.utils.data import DataLoader

    train, test = Dataset(made, split="train"), Dataset(made, split="test")
    assert {row["object"] for row in train.episodes} == {"sphere:2"}
    assert {row["object"] for row in test.episodes} == {"sphere:3"}
    assert len(train) + len(test) == len(Dataset(made))
    touches = TouchDataset(made, inputs=("rgb", "markers_px"), background=True, split="train")
    assert len(touches) == len(train)
    first, item = touches[0], touches[1]
    assert (first["rgb"] == first["rest_rgb"]).all()
    assert item["rgb"].shape == (3, SIZE[1], SIZE[0]) and float(item["rgb"].max()) <= 1
    assert item["wrench"].shape == (6,) and item["patch_forces_n"].shape == (6, 8, 3)
    batches = list(DataLoader(touches, 4, shuffle=True))
    assert sum(len(batch["wrench"]) for batch in batches) == len(touches)
    with pytest.raises(InputError, match="no channel 'heat'"):
        TouchDataset(made, inputs=("heat",))


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(bytes(data))


def change_a_value(path: Path) -> None:
    columns = pq.read_table(path).to_pydict()
    columns["episode"][1] += 1
    pq.write_table(pa.table(columns), path)


def reseed(path: Path) -> None:
    about = json.loads(path.read_text())
    about["recipe"]["spec"]["dataset"]["seed"] += 1
    path.write_text(json.dumps(about))


def replace_by_another(part: Path) -> None:
    shutil.rmtree(part)
    shutil.copytree(part.parent / "000000", part)


def flip_an_image(part: Path) -> None:
    flip(next(path for path in (part / "data.zarr" / "rgb").rglob("0") if path.is_file()))


def replace_the_next(steps: Path) -> None:
    replace_by_another(steps.parents[1] / "000001")
    flip(steps)


@pytest.mark.parametrize(
    ("what", "damage", "messages"),
    [
        ("dataset.json", reseed, ["error: .*/dataset.json: its recipe is not what was written"]),
        ("profiles/0/profile.toml", Path.unlink, ["error: .*profiles/0: cannot be read"]),
        ("profiles/0/background.npz", flip, ["error: .*profiles/0: "]),
        ("steps.parquet", change_a_value, ["error: .*steps.parquet: is not what its parts say"]),
        ("episodes.parquet", change_a_value, ["episodes.parquet: is not what its parts say"]),
        ("parts/000001", replace_by_another, ["error: .*parts/000001: is another part"]),
        ("parts/000000", flip_an_image, ["rgb.*is not what was written"]),
        ("parts/000000/episodes.parquet", Path.unlink, ["episodes.parquet: is missing"]),
        ("parts/000000/steps.parquet", replace_the_next,
         ["000000/steps.parquet: is not what was written", "parts/000001: is another part"]),
        ("parts/000002", shutil.rmtree, ["2 of 6 episodes are not made yet"]),
    ],
)  # fmt: skip
def test_check_finds_what_was_changed(
    what: str, damage: Any, messages: list[str], copied: Path
) -> None:
    damage(copied / what)
    found = [f"{f.severity}: {f}" for f in check_dataset([copied])]
    for message in messages:
        assert any(re.search(message, line) for line in found), found
    if what == "parts/000002":
        assert len(Dataset(copied).episodes) == 4


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["steps.parquet", "episodes.parquet"])
def test_no_flipped_bit_of_an_index_is_missed(name: str, copied: Path) -> None:
    """Two bytes of five are in what stands beside the rows: no reader of all rows sees them."""
    written = (copied / name).read_bytes()
    for place in np.linspace(0, len(written) - 1, 6).astype(int):
        data = bytearray(written)
        data[place] ^= 4
        (copied / name).write_bytes(bytes(data))
        assert any(f"{name}: " in str(finding) for finding in check_dataset([copied])), place
    (copied / name).write_bytes(written)
    assert check_dataset([copied]) == []


@pytest.mark.thorough
def test_check_finds_empty_constant_and_nan_columns(made: Path, tmp_path: Path) -> None:
    import zarr

    from taccel_lab.files.output_marker import OUTPUT_MARKER, write_marker

    for name, values, message in (
        ("wrench", np.nan, "error: wrench: NaN or infinite"),
        ("rgb", 7, "warning: rgb: is constant: 7 everywhere"),
    ):
        broken = tmp_path / name
        shutil.copytree(made, broken)
        for part in (broken / "parts").iterdir():
            zarr.open_group(part / "data.zarr", mode="r+")[name][:] = values
            (part / OUTPUT_MARKER).unlink()
            write_marker(part)
        told = [f"{f.severity}: {f}" for f in check_dataset([broken])]
        assert any(line.startswith(message) for line in told), told


def test_what_made_it_is_inside(made: Path) -> None:
    about = json.loads((made / "dataset.json").read_text())
    assert about["sensors"][0]["profile_digest"] == profile_digest(Dataset(made).profile(0))
    assert (made / "spec.toml").read_text() == "small"
    assert about["channels"]["wrench"]["unit"] == "N, N m"


def test_damage_is_said_with_its_file(made: Path, copied: Path) -> None:
    index = copied / "episodes.parquet"
    index.write_bytes(index.read_bytes()[:100])
    # The parts have all that the index has.
    (copied / "parts" / "9junk").mkdir()
    assert Dataset(copied).episodes == Dataset(made).episodes
    part = copied / "parts" / "000000"
    chunk = next(path for path in (part / "data.zarr" / "rgb").rglob("c/**/*") if path.is_file())
    chunk.write_bytes(b"\0" * chunk.stat().st_size)
    with pytest.raises(InputError, match=r"data\.zarr is damaged .*; taccel-lab dataset check"):
        Dataset(copied).read("rgb", slice(None))
    (part / "steps.parquet").write_bytes(b"PAR1")
    (copied / "steps.parquet").unlink()
    with pytest.raises(InputError, match=r"steps\.parquet cannot be read as Parquet"):
        _ = Dataset(copied).steps
    path = copied / "dataset.json"
    about = json.loads(path.read_text())
    for changed, said in (
        ({"format": 1}, "'name' is missing"),
        (about | {"sensors": []}, r"'sensors\.0\.name' is missing"),
        (about | {"sensors": [{**about["sensors"][0], "units": 3}]}, r"'sensors\.0\.units' is 3"),
        (about | {"channels": {"rgb": {}}}, r"'channels\.rgb\.dtype' is missing"),
    ):
        path.write_text(json.dumps(changed))
        with pytest.raises(InputError, match=rf"json is no description of a data set: {said}"):
            Dataset(copied)


@pytest.fixture
def arrays(copied: Path) -> Path:
    """Those of the first part of a data set that a stranger changes."""
    return copied / "parts" / "000000" / "data.zarr"


def rgb_of(arrays: Path) -> np.ndarray:
    return Dataset(arrays.parents[2]).read("rgb", [0])


def test_no_array_runs_what_it_holds(
    arrays: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A filter of zarr's format 2 unpickles its chunk in each numcodecs before 0.16.6."""
    import zarr

    monkeypatch.setattr(numcodecs.pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True)
    shutil.rmtree(arrays)
    group = zarr.create_group(arrays, zarr_format=2)
    filters, place = [numcodecs.Pickle()], tmp_path / "ran"
    array = group.create_array(
        "rgb", shape=(4,), chunks=(4,), dtype="f8", filters=filters, compressors=None
    )
    (arrays / "rgb" / "0").write_bytes(pickle.dumps(Payload(place)))
    with pytest.raises(FileExistsError):  # What is tested can happen.
        place.mkdir()
        array[:]
    place.rmdir()
    with pytest.raises(InputError, match=r"zarr\.json"):
        rgb_of(arrays)
    assert not place.exists()


def codec(document: dict[str, Any]) -> dict[str, Any]:
    return document["codecs"][0]["configuration"]["codecs"][-1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: codec(d).update(name="numcodecs.pickle"), "packed by 'numcodecs.pickle'"),
        (lambda d: codec(d).update(name="gzip"), "packed by 'gzip', which is not read; allowed"),
        (lambda d: d["codecs"].append({"name": "sharding_indexed"}), "packed by 'sharding"),
        (lambda d: d.update(zarr_format=2), "no array of zarr's format 3"),
        (lambda d: d.update(data_type="string"), "holds 'string', which is no type of numbers"),
        (lambda d: d.update(shape=[1 << 40, 24, 32, 3]), "rows; 16,777,216 are allowed"),
        (lambda d: d.update(shape=[8, 1 << 20, 1 << 20, 3]), "a row of .* has 3072 GiB; 4 GiB is"),
        (
            lambda d: d["codecs"][0]["configuration"].update(chunk_shape=[1, 1 << 20, 1 << 20, 3]),
            "a chunk of .* has 3072 GiB; 4 GiB is allowed",
        ),
        (lambda d: d.update(shape="8"), "is damaged"),
        (lambda d: d.pop("codecs"), "is damaged"),
    ],
)
def test_what_arrays_say_of_themselves_is_not_believed(
    arrays: Path, change: Any, message: str
) -> None:
    path = arrays / "rgb" / "zarr.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message):
        rgb_of(arrays)


def test_a_chunk_unpacks_to_its_size_and_no_further(arrays: Path) -> None:
    """1 GiB of zeros is 32 KiB of zstd, and 2^50 bytes are as easily said."""
    import google_crc32c

    (shard,) = (path for path in (arrays / "rgb" / "c").rglob("*") if path.is_file())
    sizes = json.loads((arrays / "rgb" / "zarr.json").read_text())
    blocks = sizes["chunk_grid"]["configuration"]["chunk_shape"][0] // 2
    declared = b"\x28\xb5\x2f\xfd\xe0" + (1 << 50).to_bytes(8, "little") + b"\x01\0\0"
    packed = pa.Codec("zstd").compress(bytes(1 << 28), asbytes=True)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for chunk in (packed, declared, packed[:100]):
        index = np.full((blocks, 2), 2**64 - 1, dtype="<u8")
        index[0] = 0, len(chunk)
        table = index.tobytes()
        shard.write_bytes(chunk + table + google_crc32c.value(table).to_bytes(4, "little"))
        with pytest.raises(InputError, match=r"is damaged .*ZSTD"):
            rgb_of(arrays)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 17


@pytest.mark.parametrize("name", ["../../../secret", "meshes/nodes_m", "/rgb", "a\0b", ""])
def test_a_channel_is_an_array_of_its_part(arrays: Path, name: str) -> None:
    about = arrays.parents[2] / "dataset.json"
    document = json.loads(about.read_text())
    document["channels"][name] = document["channels"]["rgb"]
    about.write_text(json.dumps(document))
    with pytest.raises(InputError, match="is damaged"):
        Dataset(arrays.parents[2]).read(name, [0])


@pytest.mark.timeout(60)
def test_tables_are_files_of_a_bounded_size(
    arrays: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A column of equal values takes a few bytes for any number of rows."""
    monkeypatch.setattr("taccel_lab.datasets.folder.MAX_TABLE_VALUES", 10)
    with pytest.raises(InputError, match=r"says that it has 2 rows; 10 values are allowed"):
        _ = Dataset(arrays.parents[2]).episodes
    lure(arrays.parent / "episodes.parquet", "pipe", tmp_path / "outside")
    with pytest.raises(InputError, match="no regular file"):
        _ = Dataset(arrays.parents[2]).episodes
