# SPDX-License-Identifier: Apache-2.0
"""Frames of data sets are those that were put in, camera by camera, episode by episode."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording
from taccel_lab.calibration.capture.camera.replay import open_camera
from taccel_lab.errors import InputError
from taccel_lab.files.videos import count_frames, read_frames

TOUCH = "observation.images.touch"
RED = np.zeros((24, 32, 3), np.uint8) + np.array([200, 40, 10], np.uint8)


def images_of(recording: Recording) -> list[np.ndarray]:
    """All frames; none may be refused."""
    found = [frame.image for frame in recording.frames()]
    assert all(isinstance(image, np.ndarray) for image in found)
    return [np.asarray(image) for image in found]


def univtac(path: Path) -> Path:
    """An episode as UniVTAC writes it: RGB handed to OpenCV's encoder."""
    with h5py.File(path, "w") as file:
        for side, shift in (("left", 0), ("right", 30)):
            gel = file.create_group(f"tactile/{side}_tactile")
            for name in ("rgb", "rgb_marker"):
                streams = [
                    cv2.imencode(".png", RED + np.uint8(shift + k))[1].tobytes() for k in range(3)
                ]
                gel.create_dataset(name, data=streams, dtype=f"S{max(map(len, streams))}")
            gel.create_dataset("depth", data=np.zeros((3, 24, 32), np.float32))
        file.create_dataset("observation/head/levels", data=np.stack([RED, RED + 1]))
        file["elsewhere"] = h5py.ExternalLink("/etc/other.hdf5", "/rgb")
        file["tactile/round"] = file["tactile"]
    return path


@pytest.mark.thorough
def test_a_camera_of_univtac_is_named_by_its_end(tmp_path: Path) -> None:
    path = univtac(tmp_path / "0.bin")  # Told by its content.
    for wanted in ("left_tactile/rgb", "tactile/left_tactile/rgb"):
        recording = Recording.of(path, wanted)
        assert recording.camera == "tactile/left_tactile/rgb" and recording.count() == 3
    for k, image in enumerate(images_of(recording)):
        np.testing.assert_array_equal(image, RED + np.uint8(k))
    head = Recording.of(path, "levels")
    np.testing.assert_array_equal(images_of(head)[1], RED + 1)
    camera = open_camera(f"{path}/right_tactile/rgb_marker")
    shot = camera.read()
    assert shot is not None and (shot.image == RED + 30).all()


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        (None, "it has several: .*left_tactile/rgb, tactile/left_tactile/rgb_marker.*right"),
        ("left", "'left' is the name of several: tactile/left_tactile/rgb, "),
        ("thumb", "none is called 'thumb': .*right_tactile/rgb"),
    ],
)
def test_cameras_are_listed_where_one_has_to_be_named(
    camera: str | None, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=f"name the camera by --camera; {said}"):
        Recording.of(univtac(tmp_path / "0.hdf5"), camera)


def test_hdf5_without_pictures_and_torn_ones_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "0.hdf5"
    with h5py.File(path, "w") as file:
        file.create_dataset("forces", data=np.zeros((3, 6)))
        # Whose order of colours nobody knows: no file of UniVTAC.
        file.create_dataset("rgb", data=[b"\xff\xd8\xff"], dtype="S3")
    with pytest.raises(InputError, match="holds no images of a camera"):
        Recording.of(path)
    with h5py.File(path, "a") as file:
        file["tactile/rgb"] = file["rgb"][()]
        del file["rgb"]
    [(_, why, *_)] = Recording.of(path).frames()
    assert isinstance(why, InputError) and "tactile/rgb 0 is not an image" in str(why)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match=r"0\.hdf5 is no HDF5 file that can be read"):
        Recording.of(path)
    with pytest.raises(InputError, match="leave --camera left away"):
        Recording.of(tmp_path, "left")


def streams(path: Path, images: Sequence[np.ndarray | bytes]) -> Path:
    """Images of one finger, or bytes that are none."""
    data = [i if isinstance(i, bytes) else cv2.imencode(".png", i)[1].tobytes() for i in images]
    with h5py.File(path, "w") as file:
        stored = file.create_dataset("tactile/rgb", (len(data),), h5py.vlen_dtype(np.uint8))
        for number, content in enumerate(data):
            stored[number] = np.frombuffer(content, np.uint8)
    return path


@pytest.mark.thorough
def test_a_stream_of_two_sizes_ends_at_the_second(tmp_path: Path) -> None:
    recording = Recording.of(streams(tmp_path / "0.hdf5", [RED, b"torn", RED[:20], RED]))
    frames = recording.frames()
    assert isinstance(next(frames).image, np.ndarray)
    assert isinstance(next(frames).image, InputError)
    with pytest.raises(InputError, match=r"0\.hdf5: frame 2 is 32x20 px; 32x24 px are needed"):
        next(frames)
    with pytest.raises(InputError, match=r"0\.hdf5: frame 0 is 32x24 px; 64x48 px are needed"):
        next(recording.frames((64, 48)))


def test_images_of_a_folder_are_refused_one_by_one(tmp_path: Path) -> None:
    for number, image in enumerate((RED[:20], RED, RED[:, :20])):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
    frames = [frame.image for frame in Recording.of(tmp_path).frames((32, 24))]
    assert [isinstance(image, InputError) for image in frames] == [True, False, True]
    assert "frame 2.png is 20x24 px; 32x24 px are needed" in str(frames[2])


def test_frames_that_cannot_be_read_one_after_another_end_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.recording.MOST_REFUSED", 3)
    torn = [b"torn", b"torn"]
    whole = Recording.of(streams(tmp_path / "0.hdf5", [*torn, RED, *torn]))
    assert [isinstance(f.image, InputError) for f in whole.frames()].count(True) == 4
    frames = Recording.of(streams(tmp_path / "1.hdf5", [RED, *torn, *torn, RED])).frames()
    assert len([next(frames) for _ in range(3)]) == 3
    with pytest.raises(
        InputError, match=r"1\.hdf5: 3 frames one after another cannot be read; the"
    ):
        next(frames)


@pytest.mark.parametrize("chunks", [(4, 5, 8, 1), (1, 24, 32, 3), (7, 24, 32, 3), (40, 24, 32, 3)])
@pytest.mark.parametrize("packing", [None, "gzip", "lzf"])
def test_packed_levels_are_those_that_were_written(
    chunks: tuple[int, ...], packing: str | None, tmp_path: Path
) -> None:
    levels = np.random.default_rng(0).integers(0, 255, (10, 24, 32, 3), dtype=np.uint8)
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        file.create_dataset(
            "a/levels", data=levels, chunks=chunks, maxshape=(None, 24, 32, 3), compression=packing
        )
    recording = Recording.of(tmp_path / "0.hdf5")
    assert recording.count() == 10
    np.testing.assert_array_equal(images_of(recording), levels)


@pytest.mark.thorough
def test_chunks_of_too_many_frames_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        noise = np.random.default_rng(0).integers(0, 255, (64, 24, 32, 3), dtype=np.uint8)
        file.create_dataset("levels", data=noise, chunks=(64, 3, 4, 3), compression="gzip")
        texts = file.create_dataset(
            "tactile/rgb",
            (3,),
            h5py.vlen_dtype(np.uint8),
            chunks=(1 << 23,),
            maxshape=(None,),
            compression="gzip",
        )
        texts[0] = np.frombuffer(b"torn", np.uint8)
    with pytest.raises(InputError, match="8,388,608 frames /tactile/rgb unpack to 128 MiB"):
        list(Recording.of(tmp_path / "0.hdf5", "rgb").frames())
    monkeypatch.setattr("taccel_lab.files.hdf5_images.BLOCK_BYTES", 64 * 24 * 32 * 3 - 1)
    monkeypatch.setattr("taccel_lab.files.hdf5_images.stream_apart", stream_here)
    with pytest.raises(InputError, match="chunks of 64 frames /levels unpack to 144 KiB at a time"):
        list(Recording.of(tmp_path / "0.hdf5", "levels").frames())


def stream_here(what: str, read: Any, *arguments: Any, by: str) -> Any:
    """Reads in this process, where limits are changed."""
    return read(*arguments)


def video(path: Path, levels: Sequence[int]) -> Path:
    """Grey frames, coded in AV1 as LeRobot codes them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libsvtav1", rate=10, options={"crf": "10", "preset": "12"})
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        for level in levels:
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), level, np.uint8), "rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def lerobot(folder: Path, version: str, **features: dict[str, Any]) -> Path:
    (folder / "meta").mkdir(parents=True)
    about = {"codebase_version": version, "total_frames": 5, "fps": 10, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(about))
    return folder


def table(path: Path, **columns: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


VIDEO = {"dtype": "video", "info": {"video.is_depth_map": False}}


def test_a_video_in_av1_is_decoded(tmp_path: Path) -> None:
    path = video(tmp_path / "v.mp4", [20, 120, 220])
    assert count_frames(path) == (3, 3)
    assert [round(float(frame.mean())) for frame in read_frames(path)] == pytest.approx(
        [20, 120, 220], abs=3
    )


def test_episodes_of_version_2_follow_one_another(tmp_path: Path) -> None:
    depth = {"dtype": "video", "info": {"is_depth_map": True}}
    folder = lerobot(tmp_path / "set", "v2.1", **{TOUCH: VIDEO, "observation.depth": depth})
    for number, levels in ((0, [10, 60]), (10, [110, 160, 210])):
        video(folder / f"videos/chunk-000/{TOUCH}/episode_{number:06d}.mp4", levels)
    # One clock is real; of the other nobody knows which row is whose.
    clock = {"episode_index": [0, 0], "frame_index": [0, 1], "timestamp": [0.03, 2.03]}
    table(folder / "data/chunk-000/episode_000000.parquet", **clock)
    clock = {"episode_index": [10, 10], "frame_index": [0, 2], "timestamp": [0.0, 0.2]}
    table(folder / "data/chunk-000/episode_000010.parquet", **clock)
    recording = Recording.of(folder)
    names, images, times, episodes = zip(*recording.frames(), strict=True)
    assert times == (0.0, 2.0, None, None, None) and episodes == (0, 0, 1, 1, 1)
    assert recording.times_from == "the data set's timestamps"
    assert recording.camera == TOUCH and recording.count() == 5
    assert names[1] == "episode 0 frame 1" and names[2] == "episode 10 frame 0"
    assert [float(i.mean()) for i in images] == pytest.approx([10, 60, 110, 160, 210], abs=3)


def test_episodes_of_version_3_are_cut_out_of_their_video(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "set", "v3.0", **{TOUCH: VIDEO})
    video(folder / f"videos/{TOUCH}/chunk-000/file-000.mp4", [10, 60, 110, 160, 210])
    of = f"videos/{TOUCH}/"
    # Episode 1 was taken out; episode 2 says that it has a frame more than there is.
    columns = {
        "episode_index": [2, 0], "length": [3, 2], f"{of}chunk_index": [0, 0],
        f"{of}file_index": [0, 0], f"{of}from_timestamp": [0.3, 0.0],
    }  # fmt: skip
    table(folder / "meta/episodes/chunk-000/file-000.parquet", **columns)
    clock = {
        "timestamp": pa.array([0.0, 0.1, 0.2, 0.0, 2.5], pa.float32()),
        "episode_index": [2, 2, 2, 0, 0],
        "frame_index": [0, 1, 2, 0, 1],
    }
    table(folder / "data/chunk-000/file-000.parquet", **clock)
    found = list(Recording.of(folder, "touch").frames())
    assert [frame.time_s for frame in found] == pytest.approx([0, 2.5, 0, 0.1, 0.2], abs=1e-6)
    assert [frame.name for frame in found] == [
        *(f"episode 0 frame {k}" for k in range(2)), *(f"episode 2 frame {k}" for k in range(3))
    ]  # fmt: skip
    images = [frame.image for frame in found]
    levels = [float(image.mean()) for image in images if isinstance(image, np.ndarray)]
    assert levels == pytest.approx([10, 60, 160, 210], abs=3)
    assert "episode 2 frame 2: the video ends before it" in str(images[-1])


def test_images_inside_and_beside_the_table_are_read(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "set", "v2.0", **{TOUCH: {"dtype": "image"}})
    png = cv2.imencode(".png", RED[..., ::-1])[1].tobytes()
    (folder / "images").mkdir()
    (folder / "images/1.png").write_bytes(png)
    (tmp_path / "outside.png").write_bytes(png)
    cells = [(png, None), (None, "images/1.png"), (None, "../outside.png"), (b"torn", None)]
    stored = pa.array([{"bytes": b, "path": p} for b, p in cells])
    columns = {"episode_index": [0] * 4, "frame_index": [0, 1, 2, 3], TOUCH: stored}
    columns["timestamp"] = [0.0, 0.1, 0.35, 0.4]
    table(folder / "data/chunk-000/episode_000000.parquet", **columns)
    found = list(Recording.of(folder).frames())
    assert [frame.time_s for frame in found] == [0.0, 0.1, 0.35, 0.4]
    inside, beside, outside, torn = (frame.image for frame in found)
    for image in (inside, beside):
        np.testing.assert_array_equal(image, RED)
    assert "'..' leads out of it" in str(outside) and "frame 3 is not an image" in str(torn)


def test_foreign_and_incomplete_data_sets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"of version 'v1\.6'; LeRobot's v2\.0, v2\.1 and v3\.0"):
        Recording.of(lerobot(tmp_path / "old", "v1.6"))
    empty = Recording.of(lerobot(tmp_path / "empty", "v3.0", **{TOUCH: VIDEO}))
    with pytest.raises(InputError, match=r"holds no meta/episodes/chunk-\*/\*\.parquet"):
        next(empty.frames())
    folder = lerobot(tmp_path / "other", "v3.0", **{TOUCH: {"dtype": "image"}})
    table(folder / "data/chunk-000/file-000.parquet", frame_index=[0], episode_index=[0])
    with pytest.raises(InputError, match=rf"has no {TOUCH}"):
        next(Recording.of(folder).frames())
