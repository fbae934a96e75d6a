import json
import os
import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from tests.zoo.public_zoos import UUIDS, member, pack, pack_members, write_zoo
from zoo import archive as archive_module
from zoo.errors import ForeignError, ZooError
from zoo.files import sha256
from zoo.foreign import find_foreign, foreign_problems, foreign_root, read_foreign
from zoo.foreign_import import import_zoo
from zoo.registry import Registry
from zoo.verify import verify


def kinds(source: Path, target: Path) -> list[Path]:
    return [
        source,
        pack(source, target / "with.tar.gz"),
        pack(source, target / "without.tar.gz", ""),
    ]


@pytest.mark.parametrize("version", [1, 2])
def test_a_zoo_is_read_from_folder_and_archive_alike(
    registry: Registry, tmp_path: Path, version: int
) -> None:
    source = write_zoo(tmp_path / "zoo", version)
    imported = [
        import_zoo(path, f"z{n}", registry.path) for n, path in enumerate(kinds(source, tmp_path))
    ]
    assert [one.zoo.policies for one in imported] == [imported[0].zoo.policies] * 3
    assert all(one.fresh and one.zoo.format == f"v{version}" for one in imported)
    robot, human, recurrent, arm = imported[0].zoo.policies
    assert [p.uuid for p in imported[0].zoo.policies] == list(UUIDS)
    assert (robot.task, robot.role, robot.algorithm, robot.recurrent) == (
        "scratch",
        "robot",
        "ippo",
        False,
    )
    assert (human.role, human.algorithm, recurrent.task, arm.task) == (
        "human",
        "masac",
        "bed_bath",
        "arm_assist",
    )
    assert human.leaves == robot.leaves and human.leaves["Dense_0/kernel"] == (
        6,
        8,
    )  # ',' and '/' alike
    assert recurrent.recurrent and recurrent.network["gru_hidden_dim"] == 128
    assert (robot.observation_size, robot.action_size) == (6, 3)
    assert robot.team == ("team-0" if version == 2 else None)
    assert robot.reward_weights == ({"w_speed": 1.0, "w_force": 0.5} if version == 2 else {})


def test_disabilities_come_from_the_configurations(registry: Registry, tmp_path: Path) -> None:
    import_zoo(write_zoo(tmp_path / "zoo"), "public", registry.path)
    robot, human, _, arm = read_foreign(registry.path)
    assert robot.policy.disability is not None and human.policy.disability is not None
    assert robot.policy.disability.joint_idx == 3 and human.policy.disability.joint_idx == (3, 4)
    assert robot.disability == "range 0.7, strength 0.4, tremor 0.1"
    assert arm.policy.disability is None and "records no disability" in arm.policy.notes[0]
    assert find_foreign(f"foreign/public/{UUIDS[1]}", registry.path) == human


def test_imports_are_immutable_and_repeatable(registry: Registry, tmp_path: Path) -> None:
    text, source = registry.path.read_text(), write_zoo(tmp_path / "zoo")
    assert import_zoo(source, "public", registry.path).fresh
    assert not import_zoo(source, "public", registry.path).fresh
    with pytest.raises(ForeignError, match="another zoo"):
        import_zoo(write_zoo(tmp_path / "other", 2), "public", registry.path)
    assert registry.path.read_text() == text
    assert [path.name for path in foreign_root(registry.path).iterdir()] == ["public"]


def test_what_a_killed_import_left_is_not_seen_and_swept(
    registry: Registry, tmp_path: Path
) -> None:
    stale = foreign_root(registry.path) / ".import-dead" / "public"
    stale.mkdir(parents=True)
    (stale / "foreign.json").write_text("{")
    assert read_foreign(registry.path) == [] and verify(registry).ok
    import_zoo(write_zoo(tmp_path / "zoo"), "public", registry.path)
    assert not stale.exists() and len(read_foreign(registry.path)) == 4


def test_verify_holds_foreign_bytes_against_their_hashes(
    registry: Registry, tmp_path: Path
) -> None:
    import_zoo(write_zoo(tmp_path / "zoo"), "public", registry.path)
    report = verify(registry)
    assert report.ok and report.foreign == 4
    one, two = (entry.path for entry in read_foreign(registry.path)[:2])
    data = bytearray(one.read_bytes())
    data[-1] ^= 1
    one.write_bytes(data)
    two.unlink()
    problems = verify(registry).problems
    assert (
        len(problems) == 2
        and f"found sha256 {sha256(bytes(data))}" in problems[0]
        and "no file at" in problems[1]
    )


def test_a_damaged_index_is_a_problem_not_a_crash(registry: Registry, tmp_path: Path) -> None:
    folder = import_zoo(write_zoo(tmp_path / "zoo"), "public", registry.path).folder
    text = (folder / "foreign.json").read_text()
    for damaged in (
        "{",
        text.replace('"scratch"', '"../x"'),
        text.replace('"v1"', '"v9"'),
        text.replace("public", "p"),
    ):
        (folder / "foreign.json").write_text(damaged)
        count, problems = foreign_problems(registry.path)
        assert count == 0 and "import the zoo again" in problems[0]


@pytest.mark.parametrize("wanted", ["foreign/public/*", f"foreign/public/{UUIDS[0]}"])
def test_the_registry_refuses_to_play_them_and_says_why(registry: Registry, wanted: str) -> None:
    for ask in (registry.select, registry.policy, registry.team):
        with pytest.raises(
            ForeignError, match=r"trained on other observations.*assistax-zoo show ID"
        ):
            ask(wanted)


def test_a_policy_that_is_no_longer_usable_gets_a_note(registry: Registry, tmp_path: Path) -> None:
    source = write_zoo(tmp_path / "zoo")
    row = safetensors.numpy.save({"Dense_0/kernel": np.ones(8, np.float32)})
    (source / "params" / f"{UUIDS[0]}.safetensors").write_bytes(row)
    wide = safetensors.numpy.save({"Dense_0/kernel": np.ones((7, 8), np.float32)})
    (source / "params" / f"{UUIDS[2]}.safetensors").write_bytes(wide)
    policies = import_zoo(source, "public", registry.path).zoo.policies
    assert "one row of a shared-parameter" in policies[0].notes[0]
    assert "reads 7 observations" in policies[2].notes[0] and "without GRU" in policies[2].notes[1]


DAMAGE: dict[str, tuple[Callable[[Path], object], str]] = {
    "no index": (lambda z: (z / "index.csv").unlink(), "found none"),
    "index no text": (
        lambda z: (z / "index.csv").write_bytes(b"\xff\xfe\x00"),
        "CSV file in UTF-8",
    ),
    "index empty": (lambda z: (z / "index.csv").write_bytes(b""), "no agent_uuid"),
    "index without rows": (lambda z: cut(z / "index.csv"), "at least one policy"),
    "a column missing": (lambda z: replace(z / "index.csv", "is_rnn", "isrnn"), "no is_rnn"),
    "a row too long": (
        lambda z: replace(z / "index.csv", "scratchitch", "scratchitch,x"),
        "values",
    ),
    "path in uuid": (
        lambda z: replace(z / "index.csv", UUIDS[0], "../../etc/passwd"),
        "agent_uuid of letters",
    ),
    "uuid twice": (lambda z: replace(z / "index.csv", UUIDS[1], UUIDS[0]), "twice"),
    "unknown scenario": (lambda z: replace(z / "index.csv", "bedbathing", "cooking"), "cooking"),
    "unknown agent": (
        lambda z: replace(z / "index.csv", "robot", "agent_0"),
        "'robot' or 'human' at role",
    ),
    "is_rnn no flag": (lambda z: replace(z / "index.csv", "True", "maybe"), "is_rnn True or False"),
    "no configuration": (lambda z: (z / "config" / f"{UUIDS[2]}.yaml").unlink(), "found none"),
    "no parameters": (lambda z: (z / "params" / f"{UUIDS[2]}.safetensors").unlink(), "found none"),
    "YAML tag": (lambda z: config(z, "a: !!python/object/apply:os.system ['true']"), "plain YAML"),
    "YAML merge bomb": (lambda z: config(z, "a: &a {x: 1}\nb: {<<: [*a, *a]}"), "merge keys"),
    "YAML list": (lambda z: config(z, "- 1"), "YAML mapping"),
    "YAML deep": (lambda z: config(z, "[" * 5000), "plain YAML"),
    "YAML no number": (
        lambda z: config(z, "ENV_KWARGS: {disability: {joint_strength: strong}}"),
        "joint_strength",
    ),
    "YAML infinite": (
        lambda z: config(z, "ENV_KWARGS: {disability: {joint_strength: .inf}}"),
        "joint_strength",
    ),
    "YAML large": (lambda z: config(z, "a: " + "x" * archive_module.MAX_CONFIG_BYTES), "at most"),
    "truncated parameters": (
        lambda z: truncate(z / "params" / f"{UUIDS[2]}.safetensors"),
        "safetensors",
    ),
    "pickle": (
        lambda z: (z / "params" / f"{UUIDS[2]}.safetensors").write_bytes(b"\x80\x04pickle."),
        "safetensors",
    ),
    "NaN": (lambda z: params(z, {"a": np.full(2, np.nan, np.float32)}), "NaN"),
    "integers": (lambda z: params(z, {"a": np.zeros(2, np.int32)}), "F32 or F16"),
    "path as a leaf": (lambda z: params(z, {"../a": np.zeros(2, np.float32)}), "leaf names"),
    "names that collide": (
        lambda z: params(z, dict.fromkeys(("a,b", "a/b"), np.zeros(2, np.float32))),
        "alone",
    ),
    "a link": (lambda z: relink(z / "params" / f"{UUIDS[2]}.safetensors"), "a link"),
    "a linked folder": (lambda z: relink(z / "params"), "a link"),
    "a pipe": (lambda z: pipe(z / "config" / f"{UUIDS[2]}.yaml"), "a regular file"),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_damaged_and_hostile_zoos_leave_nothing(
    registry: Registry, tmp_path: Path, name: str
) -> None:
    source = write_zoo(tmp_path / "zoo")
    change, words = DAMAGE[name]
    change(source)
    with pytest.raises(ZooError, match=words) as caught:
        import_zoo(source, "public", registry.path)
    assert str(caught.value).isprintable() and len(str(caught.value)) < 900
    assert list(foreign_root(registry.path).iterdir()) == []


def test_partial_leaves_the_damaged_out(registry: Registry, tmp_path: Path) -> None:
    source = write_zoo(tmp_path / "zoo")
    truncate(source / "params" / f"{UUIDS[1]}.safetensors")
    (source / "config" / f"{UUIDS[2]}.yaml").unlink()
    done = import_zoo(source, "public", registry.path, partial=True)
    assert [policy.uuid for policy in done.zoo.policies] == [UUIDS[0], UUIDS[3]] and len(
        done.left_out
    ) == 2
    for uuid in UUIDS:
        (source / "params" / f"{uuid}.safetensors").write_bytes(b"")
    with pytest.raises(ForeignError, match="none of 4"):
        import_zoo(source, "other", registry.path, partial=True)


HOSTILE = {
    "leaves the folder": (member("../index.csv", b"x"), "paths within"),
    "leaves from below": (member("zoo/../../index.csv", b"x"), "paths within"),
    "absolute": (member("/etc/index.csv", b"x"), "paths within"),
    "backslash": (member("zoo\\..\\index.csv", b"x"), "paths within"),
    "link": (
        member("zoo/index.csv", kind=tarfile.SYMTYPE, target="/etc/passwd"),
        "a link or device",
    ),
    "hard link": (
        member("zoo/index.csv", kind=tarfile.LNKTYPE, target="/etc/passwd"),
        "a link or device",
    ),
    "linked folder": (
        member("zoo/params", kind=tarfile.SYMTYPE, target="/etc"),
        "a link or device",
    ),
    "device": (member("zoo/index.csv", kind=tarfile.CHRTYPE), "a link or device"),
    "pipe": (member("zoo/index.csv", kind=tarfile.FIFOTYPE), "a link or device"),
    "large": (member("zoo/config/a.yaml", b" " * (archive_module.MAX_CONFIG_BYTES + 1)), "at most"),
    "nothing": (member("readme.txt", b"x"), "found none"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_archives_are_refused(registry: Registry, tmp_path: Path, name: str) -> None:
    planted, words = HOSTILE[name]
    with pytest.raises(ForeignError, match=words):
        import_zoo(pack_members(tmp_path / "zoo.tar.gz", planted), "public", registry.path)
    assert (
        list(foreign_root(registry.path).iterdir()) == [] and not (tmp_path / "index.csv").exists()
    )


def test_bounds_hold_for_archives(
    registry: Registry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = pack(write_zoo(tmp_path / "zoo"), tmp_path / "zoo.tar.gz")
    twice = pack_members(
        tmp_path / "twice.tar.gz", member("index.csv", b"x"), member("zoo/index.csv", b"x")
    )
    with pytest.raises(ForeignError, match="twice"):
        import_zoo(twice, "public", registry.path)
    for bound, value in (("MAX_MEMBERS", 3), ("MAX_TOTAL_BYTES", 1000)):
        with monkeypatch.context() as patch:
            patch.setattr(archive_module, bound, value)
            with pytest.raises(ForeignError, match="at most"):
                import_zoo(archive, "public", registry.path)


def test_an_unread_member_counts_towards_the_bound(
    registry: Registry, tmp_path: Path, monkeypatch
) -> None:
    """A gzip bomb under a name that is never read."""
    monkeypatch.setattr(archive_module, "MAX_TOTAL_BYTES", 100_000)
    bomb = pack_members(tmp_path / "zoo.tar.gz", member("readme.txt", bytes(1_000_000)))
    assert bomb.stat().st_size < 5000
    with pytest.raises(ForeignError, match="at most"):
        import_zoo(bomb, "public", registry.path)


@pytest.mark.parametrize("name", ["", "A", "a/b", "..", ".hidden", "a" * 33])
def test_names_are_of_the_grammar(registry: Registry, tmp_path: Path, name: str) -> None:
    with pytest.raises(ForeignError, match="name of the zoo"):
        import_zoo(write_zoo(tmp_path / "zoo"), name, registry.path)


def test_a_path_without_a_zoo(registry: Registry, tmp_path: Path) -> None:
    with pytest.raises(ForeignError, match="no such file"):
        import_zoo(tmp_path / "none", "public", registry.path)


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("packed")
    return pack(write_zoo(folder / "zoo"), folder / "zoo.tar.gz").read_bytes()


@seed(11)
@settings(deadline=None, max_examples=60)
@given(st.data())
def test_a_damaged_archive_is_refused_or_whole(
    packed: bytes, tmp_path_factory, data: st.DataObject
) -> None:
    """gzip's own check sum leaves little to the importer; what passes it must be what was packed."""
    folder = tmp_path_factory.mktemp("damaged")
    position = data.draw(st.integers(0, len(packed) - 1))
    patch = data.draw(st.binary(max_size=4))
    (folder / "zoo.tar.gz").write_bytes(
        packed[:position] + patch + packed[position + data.draw(st.integers(0, 9)) :]
    )
    registry = folder / "registry.json"
    try:
        import_zoo(folder / "zoo.tar.gz", "public", registry)
    except ZooError as error:
        assert str(error).isprintable()
        assert read_foreign(registry) == []
    else:
        assert len(read_foreign(registry)) == 4 and foreign_problems(registry) == (4, [])


def cut(path: Path) -> None:
    path.write_text(path.read_text().splitlines()[0] + "\n")


def replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def config(zoo: Path, text: str) -> None:
    (zoo / "config" / f"{UUIDS[2]}.yaml").write_text(text)


def params(zoo: Path, tensors: dict[str, np.ndarray]) -> None:
    (zoo / "params" / f"{UUIDS[2]}.safetensors").write_bytes(safetensors.numpy.save(tensors))


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-3])


def relink(path: Path) -> None:
    """Put the real thing elsewhere and a link in its place."""
    elsewhere = path.with_name(f"{path.name}-elsewhere")
    path.rename(elsewhere)
    path.symlink_to(elsewhere, target_is_directory=elsewhere.is_dir())


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def test_the_index_is_plain_json(registry: Registry, tmp_path: Path) -> None:
    folder = import_zoo(write_zoo(tmp_path / "zoo", 2), "public", registry.path).folder
    assert json.loads((folder / "foreign.json").read_text())["schema_version"] == 1
