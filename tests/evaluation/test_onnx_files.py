"""A model's weights in a file beside it are a part of the robot, and no other file is read."""

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from evaluation.cast.egos import EgoError, read_egos
from evaluation.cast.onnx_robots import files as onnx_files
from evaluation.cast.onnx_robots.files import read_claims, read_model
from evaluation.cast.roster import HostEgo
from evaluation.record.manifest import file_sha256
from population.networks.onnx_export import to_onnx
from population.networks.spec import PolicySpec
from population.networks.stack import flatten
from tests.board.onnx_files import ONNX_FILES, onnx_bytes
from tests.untrained import params_of
from zoo.registry import Registry

EMPTY: Any = Registry(data=None, path=Path("registry.json"), policies=[])  # type: ignore[arg-type]
SPEC = PolicySpec("robot", 5, 2, hidden=(8,))


def apart(folder: Path, data: bytes, location: str = "robot.onnx.data") -> Path:
    """Save a model with its weights in another file."""
    options = {"save_as_external_data": True, "location": location, "size_threshold": 0}
    onnx.save(onnx.load_from_string(data), str(folder / "robot.onnx"), **options)
    return folder / "robot.onnx"


def read(path: Path) -> tuple[Any, Any]:
    roster = read_egos([str(path)], EMPTY, "scratch")
    [member], [stack] = roster.members.values(), roster.stacks
    return member, stack


def test_weights_apart_are_the_same_robot(tmp_path: Path) -> None:
    (tmp_path / "one.onnx").write_bytes(to_onnx(SPEC, params_of(SPEC, 3)))
    path = apart(tmp_path, (tmp_path / "one.onnx").read_bytes())
    (_, whole), (member, parted) = read(tmp_path / "one.onnx"), read(path)
    assert whole.spec == parted.spec
    for name, leaf in flatten(whole.row(0)).items():
        np.testing.assert_array_equal(leaf, flatten(parted.row(0))[name])
    weights = tmp_path / "robot.onnx.data"
    assert member.files == ((path, file_sha256(path)), (weights, file_sha256(weights)))
    data = bytearray(weights.read_bytes())
    data[3] ^= 1
    weights.write_bytes(data)
    assert read(path)[0].digest != member.digest


def test_onnxruntime_plays_weights_apart(tmp_path: Path) -> None:
    path = apart(tmp_path, onnx_bytes("lstm"))
    member, ego = read(path)
    assert isinstance(ego, HostEgo) and len(member.files) == 2
    (tmp_path / "whole").mkdir()
    (tmp_path / "whole" / "robot.onnx").write_bytes(onnx_bytes("lstm"))
    _, whole = read(tmp_path / "whole" / "robot.onnx")
    obs = np.linspace(-1, 1, 68, dtype=np.float32).reshape(2, 34)
    np.testing.assert_array_equal(ego.act(obs), whole.act(obs))


def linked(folder: Path) -> None:
    (folder / "secret").write_bytes((folder / "robot.onnx.data").read_bytes())
    (folder / "robot.onnx.data").unlink()
    (folder / "robot.onnx.data").symlink_to(folder / "secret")


def piped(folder: Path) -> None:
    import os

    (folder / "robot.onnx.data").unlink()
    os.mkfifo(folder / "robot.onnx.data")


def cut(folder: Path) -> None:
    data = (folder / "robot.onnx.data").read_bytes()
    (folder / "robot.onnx.data").write_bytes(data[:-4])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "robot.onnx.data").unlink(), "No such file.*external_data=False"),
        (linked, "no regular file"),
        (piped, "no regular file"),
        (cut, "beyond the end of their file"),
    ],
)
def test_other_places_of_weights_are_refused(tmp_path: Path, change: Any, message: str) -> None:
    path = apart(tmp_path, to_onnx(SPEC, params_of(SPEC, 3)))
    change(tmp_path)
    with pytest.raises(EgoError, match=message):
        read(path)


@pytest.mark.parametrize(
    "location", ["../secret", "/etc/passwd", "a/b", ".", "..", "", "a\\b", "x\0y"]
)
def test_a_model_names_no_file_of_another_folder(tmp_path: Path, location: str) -> None:
    model = onnx.load_from_string(to_onnx(SPEC, params_of(SPEC, 3)))
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    (tmp_path / "robot.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(EgoError, match="keeps weights in ") as caught:
        read(tmp_path / "robot.onnx")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "place",
    [
        *({"offset": text} for text in ("-1", "1e9", "99999999")),
        *({"length": text} for text in ("-4", "nonsense")),
        {"offset": "4", "length": "99999999"},
    ],
)
def test_a_range_of_weights_lies_in_their_file(tmp_path: Path, place: dict[str, str]) -> None:
    path = apart(tmp_path, to_onnx(SPEC, params_of(SPEC, 3)))
    model = onnx.load(str(path), load_external_data=False)
    entries = model.graph.initializer[0].external_data
    given = {entry.key: entry.value for entry in entries} | place
    del entries[:]
    for key, text in given.items():
        entries.add(key=key, value=text)
    path.write_bytes(model.SerializeToString())
    with pytest.raises(EgoError, match="beyond the end of their file"):
        read(path)


def test_weights_that_are_named_often_are_not_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = apart(tmp_path, to_onnx(SPEC, params_of(SPEC, 3)))
    monkeypatch.setattr(onnx_files, "MAX_BYTES", 100)
    with pytest.raises(ValueError, match="more than 100 bytes of weights"):
        read_model(path)


@pytest.mark.parametrize("name", ["plain", *(n for n in ONNX_FILES if n.startswith("metadata"))])
def test_claims_are_an_object_or_nothing(name: str) -> None:
    assert read_claims(onnx_bytes(name)) == ({"env_version": 1} if name == "metadata" else {})
