"""Artefacts in a folder and in an object store on loopback."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from assistax_base.digest import sha256
from assistax_board.problems import Problem
from assistax_board.store.artefacts import Artefacts


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """Run an S3 server on loopback."""
    import boto3
    from moto.server import ThreadedMotoServer

    before = dict(os.environ)
    server = ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    keys = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test"}
    address = {"AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_DEFAULT_REGION": "us-east-1"}
    os.environ.update({**keys, **address})
    client = boto3.client("s3")
    client.create_bucket(Bucket="board")
    client.close()
    yield "s3://board/artefacts"
    server.stop()
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture(params=["folder", "s3"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Artefacts:
    if request.param == "folder":
        return Artefacts(str(tmp_path / "artefacts"))
    return Artefacts(request.getfixturevalue("bucket"))


def test_artefact_is_stored_read_and_erased(store: Artefacts) -> None:
    name = store.put(b"robot")
    assert name == store.put(b"robot") == sha256(b"robot")
    assert store.get(name) == b"robot"
    store.erase(name)
    store.erase(name)
    with pytest.raises(Problem, match="no artefact"):
        store.get(name)


def test_a_name_is_a_sha256_and_no_path(store: Artefacts) -> None:
    for name in ("../service.db", "a" * 63, "A" * 64, ""):
        with pytest.raises(Problem, match="its sha256"):
            store.get(name)


def test_repeated_upload_repairs_damaged_artefact(tmp_path: Path) -> None:
    artefacts = Artefacts(str(tmp_path))
    name = artefacts.put(b"a robot")
    (tmp_path / name[:2] / name).write_bytes(b"a robber")
    with pytest.raises(Problem, match="is damaged"):
        artefacts.get(name)
    assert artefacts.put(b"a robot") == name
    assert artefacts.get(name) == b"a robot"
