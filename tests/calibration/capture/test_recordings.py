# SPDX-License-Identifier: Apache-2.0
"""Frames of recordings and data sets are those that were put in, at the times that were stated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from taccel_lab.calibration.capture.camera.recording import Recording, name_stamps, natural_key
from taccel_lab.calibration.capture.camera.replay import CameraReplay, open_camera, open_replay
from taccel_lab.calibration.capture.load import LOST_SHARE
from taccel_lab.errors import InputError
from taccel_lab.files.videos import RecordedFrame, count_frames, read_frames, read_timed_frames

TOUCH = "observation.images.touch"
RED = np.zeros((24, 32, 3), np.uint8) + np.array([200, 40, 10], np.uint8)
PAUSED_S = [0.0, 0.033, 0.066, 2.066, 2.1]
"""Frames at 30 Hz with a pause of 2 s."""


def video(
    path: Path, levels: Sequence[int], times_s: Sequence[float] = (), codec: str = "libsvtav1"
) -> Path:
    """Grey frames, coded in AV1 as LeRobot codes them, or at times of whole milliseconds."""
    path.parent.mkdir(parents=True, exist_ok=True)
    options = {"crf": "10", "preset": "12"} if codec == "libsvtav1" else {}
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=30 if times_s else 10, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        if times_s:
            stream.codec_context.time_base = Fraction(1, 1000)
        for number, level in enumerate(levels):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), level, np.uint8), "rgb24")
            if times_s:
                frame.pts = round(1000 * times_s[number])
                frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def times_of(source: Path, fps: float | None = None) -> list[float | None]:
    return [frame.time_s for frame in Recording.of(source, fps=fps).frames()]


@pytest.mark.parametrize(
    ("name", "codec"), [("v.mp4", "mpeg4"), ("v.mkv", "mpeg4"), ("v.mov", "libx264")]
)
def test_a_video_of_variable_rate_keeps_its_pause(name: str, codec: str, tmp_path: Path) -> None:
    # It begins a second late, as recorders write it that cut a stream.
    late_s, levels = [1 + time_s for time_s in PAUSED_S], [20, 40, 60, 80, 100]
    path = video(tmp_path / name, levels, late_s, codec)
    assert [time_s for time_s, _ in read_timed_frames(path)] == pytest.approx(late_s, abs=1e-3)
    recording = Recording.of(path)
    assert times_of(path) == pytest.approx(PAUSED_S, abs=1e-3)
    assert [image.mean() for image in images_of(recording)] == pytest.approx(levels, abs=4)
    assert recording.times_from == "the video's own times"
    assert times_of(path, fps=10.0) == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_a_container_without_a_count_states_what_fills_its_duration(tmp_path: Path) -> None:
    """WebM and MKV count no frames; a pause makes none of them miss, an end cut off does."""
    times_s = [*np.arange(0, 1, 0.04), *np.arange(9, 12, 0.04)]
    path = video(tmp_path / "v.mkv", [20, 40, 60, 80, 100] * 20, times_s, "mpeg4")
    count, stated = count_frames(path)
    assert count == 100 and stated == pytest.approx(100, abs=2)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    count, stated = count_frames(path)
    assert 0 < count < LOST_SHARE * stated


@pytest.mark.parametrize(("names", "times_s"), [
    (["1699999999033000000", "1699999999066000000", "1700000001066000000"], [0.0, 0.033, 2.033]),
    (["1699999999.033", "1699999999.066", "1700000001.066"], [0.0, 0.033, 2.033]),
    (["left_1699999999-033000000", "left_1700000001-066000000"], [0.0, 2.033]),
    (["1699999999033_rgb", "1699999999066_rgb", "1700000001066_rgb"], [0.0, 0.033, 2.033]),
    (["1699999999033000", "1699999999066000", "1700000001066000"], [0.0, 0.033, 2.033]),
    (["frame_0", "frame_1"], None),
    (["0000000001", "0000000002"], None),  # Counters.
    (["20231114_101112", "20231114_101113"], None),  # Dates.
    (["1699999999033000000", "background"], None),
    (["left_1699999999", "right_1700000000"], None),  # Two cameras.
    (["1699999999.5", "1699999999.50"], None),  # Twice the same.
    (["1699999999_1700000000", "1699999999_1700000001"], None),  # Which of them?
    (["12033000000", "12066000000"], None),  # Of a simulation's clock, or numbers.
    (["16999999990330000001", "16999999990660000001"], None),  # A digit more than nanoseconds have.
    ([], None),
])  # fmt: skip
def test_stamps_in_names_are_times(names: list[str], times_s: list[float] | None) -> None:
    found = name_stamps(names)
    assert found is None if times_s is None else found == pytest.approx(times_s, abs=1e-12)


def test_natural_order() -> None:
    names = ["f_10", "f_2", "f_1", "g", "2", "10"]
    assert sorted(names, key=natural_key) == ["2", "10", "f_1", "f_2", "f_10", "g"]
    # Digits of other scripts are none.
    assert sorted(["²", "10", "2", "١"], key=natural_key)[:2] == ["2", "10"]


def test_images_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    """Programs that drop zeros behind the point write .5 for what comes after .033."""
    for number, name in enumerate(["1699999999.033", "1699999999.5", "1700000001.5"]):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((8, 8, 3), 50 * number, np.uint8))
    recording = Recording.of(tmp_path)
    assert [int(image[0, 0, 0]) for image in images_of(recording)] == [0, 50, 100]
    assert times_of(tmp_path) == [0.0, 0.467, 2.467]
    assert recording.times_from == "the stamps in the names"
    assert times_of(tmp_path, fps=2.0) == [0.0, 0.5, 1.0]


def test_a_clock_that_stands_or_goes_back_tells_nothing_until_it_is_ahead_again() -> None:
    clock = [5.0, 5.1, 5.1, 4.0, 5.2, float("nan"), None, 5.3]
    torn = InputError("torn")
    frames = [RecordedFrame("", torn, time_s, 7) for time_s in clock]
    frames += [RecordedFrame("", torn, time_s, 3) for time_s in (0.0, 0.1)]
    found = list(Recording(Path(), "", lambda: 10, lambda: iter(frames)).frames())
    assert [frame.time_s for frame in found] == [0, 0.1, None, None, 0.2, None, None, 0.3, 0, 0.1]
    assert [frame.episode for frame in found] == [0] * 8 + [1] * 2
    rated = Recording(Path(), "", lambda: 10, lambda: iter(frames), fps=10.0)
    assert [frame.time_s for frame in rated.frames()][-3:] == [0.7, 0.0, 0.1]
    assert rated.times_from == "--fps 10"


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf"), 1e300, 1e-300])
def test_a_rate_that_is_none_is_refused(fps: float, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--fps must lie in"):
        Recording.of(tmp_path, fps=fps)


def test_a_replay_keeps_the_pause(tmp_path: Path) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((8, 8, 3), np.uint8))
    path = video(tmp_path / "v.mp4", [20] * 5, PAUSED_S, "mpeg4")
    for camera, times_s in (
        (open_replay(path), PAUSED_S),
        (open_replay(tmp_path, CameraReplay(fps=10.0)), [0, 0.1, 0.2]),
    ):
        shots = [camera.read() for _ in times_s]
        found = [shot.time_s for shot in shots if shot is not None]
        assert found == pytest.approx(times_s, abs=1e-3) and camera.read() is None


def images_of(recording: Recording) -> list[np.ndarray]:
    """All frames; none may be refused."""
    found = [frame.image for frame in recording.frames()]
    assert all(isinstance(image, np.ndarray) for image in found)
    return [np.asarray(image) for image in found]


def coded(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def univtac(path: Path) -> Path:
    """An episode as UniVTAC writes it: RGB handed to OpenCV's encoder."""
    with h5py.File(path, "w") as file:
        for side, shift in (("left", 0), ("right", 30)):
            gel = file.create_group(f"tactile/{side}_tactile")
            for name in ("rgb", "rgb_marker"):
                streams = [coded(RED + np.uint8(shift + k)) for k in range(3)]
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
    np.testing.assert_array_equal(images_of(recording), [RED + np.uint8(k) for k in range(3)])
    np.testing.assert_array_equal(images_of(Recording.of(path, "levels"))[1], RED + 1)
    shot = open_camera(f"{path}/right_tactile/rgb_marker").read()
    assert shot is not None and (shot.image == RED + 30).all()


@pytest.mark.parametrize(("camera", "said"), [
    (None, "it has several: .*left_tactile/rgb, tactile/left_tactile/rgb_marker.*right"),
    ("left", "'left' is the name of several: tactile/left_tactile/rgb, "),
    ("thumb", "none is called 'thumb': .*right_tactile/rgb"),
])  # fmt: skip
def test_cameras_are_listed_to_choose_from(camera: str | None, said: str, tmp_path: Path) -> None:
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
    with h5py.File(path, "w") as file:
        stored = file.create_dataset("tactile/rgb", (len(images),), h5py.vlen_dtype(np.uint8))
        for number, image in enumerate(images):
            content = image if isinstance(image, bytes) else coded(image)
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


@pytest.mark.thorough
def test_many_torn_frames_end_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("taccel_lab.calibration.capture.camera.recording.MOST_REFUSED", 3)
    torn = [b"torn", b"torn"]
    whole = Recording.of(streams(tmp_path / "0.hdf5", [*torn, RED, *torn]))
    assert [isinstance(f.image, InputError) for f in whole.frames()].count(True) == 4
    frames = Recording.of(streams(tmp_path / "1.hdf5", [RED, *torn, *torn, RED])).frames()
    assert len([next(frames) for _ in range(3)]) == 3
    with pytest.raises(InputError, match=r"1\.hdf5: 3 frames one after another cannot be read; t"):
        next(frames)


@pytest.mark.parametrize("chunks", [(4, 5, 8, 1), (1, 24, 32, 3), (7, 24, 32, 3), (40, 24, 32, 3)])
@pytest.mark.parametrize("packing", [None, "gzip", "lzf"])
def test_packed_levels(chunks: tuple[int, ...], packing: str | None, tmp_path: Path) -> None:
    levels = np.random.default_rng(0).integers(0, 255, (10, 24, 32, 3), dtype=np.uint8)
    stored = {"data": levels, "chunks": chunks, "maxshape": (None, 24, 32, 3)}
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        file.create_dataset("a/levels", compression=packing, **stored)
    recording = Recording.of(tmp_path / "0.hdf5")
    assert recording.count() == 10
    np.testing.assert_array_equal(images_of(recording), levels)


@pytest.mark.thorough
def test_chunks_of_too_many_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packed = {"compression": "gzip", "dtype": h5py.vlen_dtype(np.uint8), "maxshape": (None,)}
    with h5py.File(tmp_path / "0.hdf5", "w") as file:
        noise = np.random.default_rng(0).integers(0, 255, (64, 24, 32, 3), dtype=np.uint8)
        file.create_dataset("levels", data=noise, chunks=(64, 3, 4, 3), compression="gzip")
        texts = file.create_dataset("tactile/rgb", (3,), chunks=(1 << 23,), **packed)
        texts[0] = np.frombuffer(b"torn", np.uint8)
    with pytest.raises(InputError, match="8,388,608 frames /tactile/rgb unpack to 128 MiB"):
        list(Recording.of(tmp_path / "0.hdf5", "rgb").frames())

    def stream_here(what: str, read: Any, *arguments: Any, by: str) -> Any:
        """Reads in this process, where limits are changed."""
        return read(*arguments)

    monkeypatch.setattr("taccel_lab.files.hdf5_images.BLOCK_BYTES", 64 * 24 * 32 * 3 - 1)
    monkeypatch.setattr("taccel_lab.files.hdf5_images.stream_apart", stream_here)
    with pytest.raises(InputError, match="chunks of 64 frames /levels unpack to 144 KiB at a time"):
        list(Recording.of(tmp_path / "0.hdf5", "levels").frames())


VIDEO = {"dtype": "video", "info": {"video.is_depth_map": False}}
EPISODE = "data/chunk-000/episode_{:06d}.parquet"


def lerobot(folder: Path, version: str, **features: dict[str, Any]) -> Path:
    (folder / "meta").mkdir(parents=True)
    about = {"codebase_version": version, "total_frames": 5, "fps": 10, "features": features}
    (folder / "meta" / "info.json").write_text(json.dumps(about))
    return folder


def table(path: Path, **columns: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


def test_episodes_of_version_2_follow_one_another(tmp_path: Path) -> None:
    depth = {"dtype": "video", "info": {"is_depth_map": True}}
    folder = lerobot(tmp_path / "set", "v2.1", **{TOUCH: VIDEO, "observation.depth": depth})
    for number, levels in ((0, [10, 60]), (10, [110, 160, 210])):
        video(folder / f"videos/chunk-000/{TOUCH}/episode_{number:06d}.mp4", levels)
    # One clock is real; of the other nobody knows which row is whose.
    for episode, frames, times_s in ((0, [0, 1], [0.03, 2.03]), (10, [0, 2], [0.0, 0.2])):
        clock = {"episode_index": [episode] * 2, "frame_index": frames, "timestamp": times_s}
        table(folder / EPISODE.format(episode), **clock)
    recording = Recording.of(folder)
    names, images, times, episodes = zip(*recording.frames(), strict=True)
    assert times == (0.0, 2.0, None, None, None) and episodes == (0, 0, 1, 1, 1)
    assert recording.times_from == "the data set's timestamps"
    assert recording.camera == TOUCH and recording.count() == 5
    assert names[1] == "episode 0 frame 1" and names[2] == "episode 10 frame 0"
    assert [float(i.mean()) for i in images] == pytest.approx([10, 60, 110, 160, 210], abs=3)


def test_episodes_of_version_3_are_cut_out_of_their_video(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "set", "v3.0", **{TOUCH: VIDEO})
    path = video(folder / f"videos/{TOUCH}/chunk-000/file-000.mp4", [10, 60, 110, 160, 210])
    assert count_frames(path) == (5, 5) and len([*read_frames(path)]) == 5
    of = f"videos/{TOUCH}/"
    # Episode 1 was taken out; episode 2 says that it has a frame more than there is.
    columns = {
        "episode_index": [2, 0], "length": [3, 2], f"{of}chunk_index": [0, 0],
        f"{of}file_index": [0, 0], f"{of}from_timestamp": [0.3, 0.0],
    }  # fmt: skip
    table(folder / "meta/episodes/chunk-000/file-000.parquet", **columns)
    clock = {"episode_index": [2, 2, 2, 0, 0], "frame_index": [0, 1, 2, 0, 1]}
    times = pa.array([0.0, 0.1, 0.2, 0.0, 2.5], pa.float32())
    table(folder / "data/chunk-000/file-000.parquet", timestamp=times, **clock)
    names, images, times_s, _ = zip(*Recording.of(folder, "touch").frames(), strict=True)
    assert times_s == pytest.approx([0, 2.5, 0, 0.1, 0.2], abs=1e-6)
    wanted = [(0, 0), (0, 1), (2, 0), (2, 1), (2, 2)]
    assert list(names) == [f"episode {episode} frame {k}" for episode, k in wanted]
    assert [image.mean() for image in images[:4]] == pytest.approx([10, 60, 160, 210], abs=3)
    assert "episode 2 frame 2: the video ends before it" in str(images[-1])


def test_images_inside_and_beside_the_table_are_read(tmp_path: Path) -> None:
    folder = lerobot(tmp_path / "set", "v2.0", **{TOUCH: {"dtype": "image"}})
    png = coded(RED[..., ::-1])
    (folder / "images").mkdir()
    for path in (folder / "images/1.png", tmp_path / "outside.png"):
        path.write_bytes(png)
    cells = [(png, None), (None, "images/1.png"), (None, "../outside.png"), (b"torn", None)]
    stored, times_s = pa.array([{"bytes": b, "path": p} for b, p in cells]), [0.0, 0.1, 0.35, 0.4]
    columns = {"episode_index": [0] * 4, "frame_index": [0, 1, 2, 3], "timestamp": times_s}
    table(folder / EPISODE.format(0), **columns, **{TOUCH: stored})
    found = list(Recording.of(folder).frames())
    assert [frame.time_s for frame in found] == times_s
    inside, beside, outside, torn = (frame.image for frame in found)
    np.testing.assert_array_equal(inside, RED)
    np.testing.assert_array_equal(beside, RED)
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
