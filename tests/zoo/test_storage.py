import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy

from assistax_base.errors import FormatError, IntegrityError
from population.networks.spec import PolicySpec
from population.networks.stack import unflatten
from population.networks.tensors import (
    MAX_HEADER_BYTES,
    encode,
    flatten,
    parse_stacked,
    row_sha256,
)
from tests.zoo.conftest import edited
from zoo.parameters.encoding import check_params, encode_shard
from zoo.parameters.storage import load_stacks, read_policy_file, write_policy_file
from zoo.registry import Registry


def leaves_equal(first, other) -> bool:
    first, other = flatten(first), flatten(other)
    equal = (np.array_equal(value, other.get(name)) for name, value in first.items())
    return first.keys() == other.keys() and all(equal)


def header(content: object, body: bytes = b"") -> bytes:
    text = content if isinstance(content, bytes) else json.dumps(content).encode()
    return struct.pack("<Q", len(text)) + text + body


def test_groups_hold_published_parameters_in_order(registry: Registry, team) -> None:
    members = ("d9-s3-v0/human", "d1-s2-v0/robot", "d1-s0-v0/human")
    names = [f"scratch/ippo-{member}" for member in members]
    human, robot = load_stacks(registry, [registry.policy(name) for name in names])
    assert human.ids == (names[0], names[2]) and robot.ids == (names[1],)
    assert human.spec.role == "human" and robot.spec.role == "robot"
    for group in (human, robot):
        for row, name in enumerate(group.ids):
            entry = registry.policy(name)
            expected = team(entry.algorithm, entry.disability, entry.seed).params[entry.role]
            stacked = flatten(group.params)
            assert all(v.dtype == np.float32 and v.flags.c_contiguous for v in stacked.values())
            assert leaves_equal(unflatten({name: v[row] for name, v in stacked.items()}), expected)


def test_only_shards_of_one_spec_merge(registry: Registry, team, specs, publish_to) -> None:
    wide = {**specs, "robot": PolicySpec("robot", 5, 2, hidden=(8,))}
    grown = publish_to([team("mappo", "d1", 0, specs=wide)], registry.path)
    groups = load_stacks(grown, grown.select("*-s0-*"))
    found = [(group.spec.role, group.spec.hidden, len(group.ids)) for group in groups]
    assert found == [("robot", (4,), 2), ("human", (4,), 3), ("robot", (8,), 1)]


def test_half_precision_is_returned_as_float32(
    tmp_path: Path, team, params, publish_to, specs
) -> None:
    half = {role: params(spec, 5, np.float16) for role, spec in specs.items()}
    registry = publish_to([team(params=half)], tmp_path / "registry.json")
    entry = registry.policies[0]
    assert "F16" in registry.shard_path(entry.shard).read_bytes()[:400].decode(errors="replace")
    group = load_stacks(registry, [entry])[0]
    kernel = group.params["Dense_0"]["kernel"]
    assert kernel.dtype == np.float32
    assert np.array_equal(kernel[0], half["robot"]["Dense_0"]["kernel"])


def test_row_hash_covers_names_dtypes_shapes_bytes(params, specs) -> None:
    leaves = flatten(params(specs["robot"], 0))
    digest = row_sha256(leaves)
    assert row_sha256(dict(reversed(leaves.items()))) == digest
    name = "Dense_0/kernel"
    changes = [
        {**leaves, name: leaves[name].T},
        {**leaves, name: leaves[name].reshape(-1)},
        {**leaves, name: np.asfortranarray(leaves[name]) + np.float32(1e-6)},
        {
            **{key: value for key, value in leaves.items() if key != name},
            "Dense_0/kernels": leaves[name],
        },
        {key: value.astype(np.float16) for key, value in leaves.items()},
    ]
    assert len({digest, *map(row_sha256, changes)}) == 6
    assert row_sha256({**leaves, name: np.asfortranarray(leaves[name])}) == digest


def test_a_flipped_byte_is_refused_with_both_hashes(registry: Registry) -> None:
    entry = registry.policies[0]
    path = registry.shard_path(entry.shard)
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(data)
    assert len(safetensors.numpy.load(bytes(data))) == 7  # it sees no difference itself
    with pytest.raises(IntegrityError) as caught:
        load_stacks(registry, [entry])
    message = str(caught.value)
    assert f"expected sha256 {registry.data.shards[entry.shard].sha256}, found sha256 " in message
    assert entry.shard in message and "nothing was loaded" in message and "git checkout" in message
    # The other shard is whole.
    assert len(load_stacks(registry, registry.select(role="human"))) == 1


def test_a_row_that_is_not_the_registrys_is_refused(registry: Registry) -> None:
    entry, other = registry.policies[0], registry.policies[2]

    def swap(data: dict[str, Any]) -> None:
        data["teams"][entry.team]["policies"]["robot"]["sha256"] = other.sha256

    tampered = edited(registry, swap)
    words = f"{entry.id}: expected sha256 {other.sha256}, found sha256 {entry.sha256}"
    with pytest.raises(IntegrityError, match=words):
        load_stacks(tampered, [tampered.policy(entry.id)])


def test_truncated_missing_and_grown_shards_are_refused(registry: Registry) -> None:
    entry = registry.policies[0]
    path = registry.shard_path(entry.shard)
    whole = path.read_bytes()
    for data in (whole[:-1], whole[:7], b"", whole + b"\0"):
        path.write_bytes(data)
        words = f"expected {len(whole)} bytes, found {len(data)} bytes"
        with pytest.raises(IntegrityError, match=words):
            load_stacks(registry, [entry])
    path.unlink()
    with pytest.raises(IntegrityError, match="no file at"):
        load_stacks(registry, [entry])


SPEC = {"role": "robot", "observation_size": 1, "action_size": 1}
META = {"__metadata__": {"assistax": json.dumps({"spec": SPEC, "rows": [0]})}}
LEAF = {"dtype": "F32", "shape": [1, 1], "data_offsets": [0, 4]}
BODY = struct.pack("<f", 1.0)
HOSTILE = {
    "empty": b"",
    "seven bytes": b"1234567",
    "header of 2^63 bytes": struct.pack("<Q", 2**63) + b"{}",
    "header beyond the file": struct.pack("<Q", 100) + b"{}",
    "header beyond the bound": struct.pack("<Q", MAX_HEADER_BYTES + 1)
    + b" " * (MAX_HEADER_BYTES + 1),
    "no JSON": header(b"\x80\x04pickle."),
    "a list": header([]),
    "deep nesting": header(b'{"a":' * 5000),
    "no metadata": header({"a": LEAF}, BODY),
    "metadata of another tool": header({"__metadata__": {"format": "pt"}, "a": LEAF}, BODY),
    "metadata no JSON": header({"__metadata__": {"assistax": "{"}, "a": LEAF}, BODY),
    "metadata no object": header({"__metadata__": {"assistax": "[]"}, "a": LEAF}, BODY),
    "no leaf": header(META),
    "overlap": header({**META, "a": LEAF, "b": LEAF}, BODY),
    "gap": header({**META, "a": {**LEAF, "data_offsets": [4, 8]}}, BODY + BODY),
    "beyond the end": header(
        {**META, "a": {**LEAF, "shape": [2, 1], "data_offsets": [0, 8]}}, BODY
    ),
    "bytes left over": header({**META, "a": LEAF}, BODY + b"#!/bin/sh"),
    "shape not the size": header({**META, "a": {**LEAF, "shape": [3, 1]}}, BODY),
    "overflowing shape": header({**META, "a": {**LEAF, "shape": [2**62, 2**62]}}, BODY),
    "negative shape": header({**META, "a": {**LEAF, "shape": [-1, 1]}}, BODY),
    "path as a name": header({**META, "../../etc/passwd": LEAF}, BODY),
    "leaf below a leaf": header(
        {**META, "a": LEAF, "a/b": {**LEAF, "data_offsets": [4, 8]}}, BODY + BODY
    ),
    "integers": header({**META, "a": {**LEAF, "dtype": "I32"}}, BODY),
    "unknown dtype": header({**META, "a": {**LEAF, "dtype": "O"}}, BODY),
    "NaN": header({**META, "a": LEAF}, struct.pack("<f", float("nan"))),
    "a key twice": header(
        f'{{"a":{json.dumps(LEAF)},"a":{json.dumps(LEAF)},{json.dumps(META)[1:]}'.encode(), BODY
    ),
}  # fmt: skip


def test_hostile_files_without_defect_are_read() -> None:
    assert parse_stacked(header({**META, "a": LEAF}, BODY), "good").spec.role == "robot"


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    path.write_bytes(HOSTILE[name])
    for read in (lambda: parse_stacked(HOSTILE[name], "shard x"), lambda: read_policy_file(path)):
        with pytest.raises(FormatError) as caught:
            read()
        assert str(caught.value).isprintable() and len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("metadata", "words"),
    [
        ({"rows": [0]}, "policy spec"),
        ({"spec": {**SPEC, "torso": "cnn"}, "rows": [0]}, "torso"),
        ({"spec": SPEC}, "rows"),
        ({"spec": SPEC, "rows": []}, "rows"),
        ({"spec": SPEC, "rows": [0, 1]}, "first axis of 2"),
    ],
)
def test_stacked_metadata_must_say_what_the_rows_are(metadata: dict, words: str) -> None:
    with pytest.raises(FormatError, match=words):
        parse_stacked(encode({"a": np.zeros((1, 2), np.float32)}, metadata), "shard x")


def test_policy_files_round_trip(tmp_path: Path, params, specs) -> None:
    path, tree = tmp_path / "mine.safetensors", params(specs["robot"], 1)
    write_policy_file(path, specs["robot"], tree, {"author": "me", "steps": 3})
    spec, params_read, metadata = read_policy_file(path)
    assert spec == specs["robot"] and metadata == {"author": "me", "steps": 3}
    assert leaves_equal(params_read, tree)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"tanh", b"relu"))
    with pytest.raises(IntegrityError):
        read_policy_file(path)
    path.write_bytes(data[:-2] + bytes([data[-2] ^ 1]) + data[-1:])
    with pytest.raises(IntegrityError, match=r"expected sha256 .* found sha256"):
        read_policy_file(path)
    with pytest.raises(FormatError, match="no such file"):
        read_policy_file(tmp_path / "other.safetensors")


def test_what_cannot_be_stored_is_refused(tmp_path: Path, params, specs) -> None:
    tree = params(specs["robot"], 1)
    for bad in (
        {},
        {**tree, "log_std": np.full(2, np.nan, np.float32)},
        {**tree, "log_std": np.zeros(2)},
        {**tree, "log_std": np.zeros(2, np.int32)},
        {**tree, "log std": np.zeros(2, np.float32)},
        {**tree, "log_std": None},
    ):
        with pytest.raises(FormatError):
            write_policy_file(tmp_path / "mine.safetensors", specs["robot"], bad)
    assert list(tmp_path.iterdir()) == []


def test_rows_of_a_shard_have_one_form(params, specs) -> None:
    first, other = flatten(params(specs["robot"], 1)), flatten(params(specs["human"], 1))
    with pytest.raises(FormatError, match=r"Dense_0/kernel .*\(5, 4\).*\(6, 4\)"):
        encode_shard(specs["robot"], [("a", first), ("b", other)])


def test_parameters_must_fit_their_specs_network(params, specs) -> None:
    leaves = flatten(params(specs["robot"], 1))
    check_params(specs["robot"], leaves, "p")
    lacking = {name: value for name, value in leaves.items() if name != "log_std"}
    with pytest.raises(FormatError, match=r"log_std of shape \(2,\)"):
        check_params(specs["robot"], lacking, "p")
    with pytest.raises(FormatError, match="Dense_0/kernel"):
        check_params(specs["human"], leaves, "p")
