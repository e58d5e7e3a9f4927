# SPDX-License-Identifier: Apache-2.0
"""Folders of others: what a link leads to outside of them is neither read nor quoted; what a user
names may be a link, as tools that version data leave them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import require_inner_links
from tests.fuzz.guard import SECRET, SECRET_WORD
from tests.fuzz.reader import Refused
from tests.fuzz.readers import READERS

IN_FOLDERS = {
    "profile": ["profile/profile.toml", "profile/mesh.npz"],
    "profile-views": ["profile/views/left/profile.toml", "profile/views/left/background.npz"],
    "captures": ["captures.toml", "contacts.toml"],
    "capture-rectify": ["raw/contacts.toml"],
    "check-draft": ["labels.csv"],
    "import-taxim": ["dataPack.npz", "params.json"],
    "taxim-pack": ["params.json"],
    "import-9dtact": [
        "shape_config.yaml",
        "calibration/sensor_1/depth_calibration/sample_drawing.png",
    ],
    "import-gs-sdk": ["gsmini.yaml"],
    "import-printer": ["printer_presses.csv"],
    "import-markers": ["0000.png"],
    "import-plain": ["other_camera.png"],
    "recording-lerobot": ["set/meta/info.json"],
    "robot-urdf": ["words.stl"],
}
"""Readers, and files of their sample that they come upon themselves."""
NAMED = {
    "depth": ["press.png"],
    "texture": ["coin.png"],
    "capture-rectify": ["maps.npz"],
    "taxim-pack": ["dataPack.npz"],
    "study-file": ["study.toml"],
    "dataset-file": ["touches.toml"],
    "recording-hdf5": ["0.hdf5"],
    "step-import": ["gel.step", "faces.toml"],
    "gel-msh": ["gel.msh"],
    "indenter-stl": ["bytes.stl"],
    "indenter-ply": ["words.ply"],
    "indenter-obj": ["box.obj"],
    "robot-urdf": ["gripper.urdf"],
    "robot-mjcf": ["gripper.xml"],
    "robot-usd": ["gripper.usda"],
}
"""Readers, and files that their user names."""


def pairs(table: dict[str, list[str]]) -> list[tuple[str, str]]:
    return [(reader, name) for reader, names in table.items() for name in names]


@pytest.fixture
def sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    def made(reader: str) -> Path:
        if reader not in READERS:
            pytest.skip(f"what {reader} needs is not installed")
        given = tmp_path / "given"
        given.mkdir()
        READERS[reader].make(given)
        return given

    monkeypatch.chdir(tmp_path)
    return made


def link_to(path: Path, content: bytes, name: str) -> None:
    """A link to a file of this content elsewhere, in place of a file."""
    target = Path.cwd() / "elsewhere" / name
    target.parent.mkdir(exist_ok=True)
    target.write_bytes(content)
    path.unlink()
    path.symlink_to(target)


@pytest.mark.parametrize(("reader", "name"), pairs(IN_FOLDERS))
def test_a_link_out_of_a_folder_is_not_followed(
    reader: str, name: str, sample: Callable[[str], Path], tmp_path: Path
) -> None:
    given = sample(reader)
    sound = (given / name).read_bytes()
    for content in (sound, SECRET):
        link_to(given / name, content, Path(name).name)
        with pytest.raises((InputError, Refused), match=r"is a link out of .*cp -rL") as found:
            READERS[reader].call(given, tmp_path / "out")
        assert SECRET_WORD not in str(found.value)
        assert not (tmp_path / "out").exists()


@pytest.mark.thorough(cases=("dataset-file-touches.toml", "step-import-gel.step"))
@pytest.mark.parametrize(("reader", "name"), pairs(NAMED))
def test_a_file_that_is_named_may_be_a_link(
    reader: str, name: str, sample: Callable[[str], Path], tmp_path: Path
) -> None:
    """As git-annex and DVC keep data: under a name that says nothing of its format."""
    given = sample(reader)
    link_to(given / name, (given / name).read_bytes(), "MD5-s12--900150983cd24fb0")
    READERS[reader].call(given, tmp_path / "out")


@pytest.mark.thorough(cases=("dataset-folder-data", "recording-lerobot-set"))
@pytest.mark.parametrize(
    ("reader", "name"),
    [
        ("profile", "profile"), ("captures", "."), ("import-9dtact", "."), ("camera-replay", "."),
        ("recording-lerobot", "set"), ("study-folder", "study"), ("dataset-folder", "data"),
    ],
)  # fmt: skip
def test_a_folder_may_be_a_link_itself(
    reader: str, name: str, sample: Callable[[str], Path], tmp_path: Path
) -> None:
    folder = sample(reader) / name
    shutil.move(folder.resolve(), tmp_path / "real")
    Path(str(folder.absolute()).removesuffix("/.")).symlink_to(tmp_path / "real")
    READERS[reader].call(tmp_path / "given", tmp_path / "out")


def test_links_within_a_folder_and_hidden_ones_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "beside").touch()
    folder = tmp_path / "folder"
    (folder / "sub" / ".venv").mkdir(parents=True)
    (folder / "a").touch()
    (folder / "sub" / "b").symlink_to("../a")
    (folder / "sub" / "round").symlink_to("..")
    (folder / "gone").symlink_to("nothing")
    (folder / "sub" / ".venv" / "python").symlink_to(tmp_path / "beside")
    require_inner_links(folder)
    (folder / "sub" / "c").symlink_to("../../beside")
    require_inner_links(folder, levels=1)
    with pytest.raises(InputError, match="sub/c is a link out of"):
        require_inner_links(folder)
