"""Files from elsewhere: bounds hold before parsing, and no text reaches a terminal raw."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from assistax_base import parallel
from assistax_base.bounded_reading import MAX_VALUES
from assistax_base.errors import FormatError, RegistryError, RemoteError, shorten
from assistax_workshop.press.trained_runs import read_run
from assistax_zoo.shell.main import run
from tests.zoo.conftest import wait_for
from tests.zoo.hub_server import Fault, Hub
from zoo.exports.card import find_cards, markdown_card
from zoo.locations import cached_shard
from zoo.registry import Registry, parse_registry
from zoo.saving import save_registry
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import fetch

ROOT = Path(__file__).parents[2]
READERS = {
    "registry": "from zoo.registry import load_registry as read",
    "lock": "from zoo.lock import read_lock as read",
    "run": "from assistax_workshop.press.trained_runs import read_run\n"
    "read = lambda path: read_run(path.parent)",
    "policy": "from zoo.parameters.storage import read_policy_file as read",
}
LIMIT = 1 << 30  # bytes of memory, the interpreter included


def large(kind: str) -> bytes:
    """Files that small parsers die of."""
    if kind == "zeros":
        return bytes(60_000_000)
    if kind == "list":
        return b"[" + b"0," * 7_900_000 + b"0]"
    if kind == "splits":
        return b'{"schema_version": 2, "splits": [' + b"0," * (MAX_VALUES - 9) + b"0]}"
    names = b",".join(b'"a%d":0' % n for n in range(MAX_VALUES - 9))
    return b'{"schema_version": 2, "lock_version": 3, "teams": {' + names + b"}}"


@pytest.mark.slow_for("table", "splits")
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["zeros", "list", "splits", "table"])
def test_large_files_are_refused_in_little_memory(reader: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / ("teams.json" if reader == "run" else "file")
    path.write_bytes(large(kind))
    code = (
        "import re, sys; from pathlib import Path; from assistax_base.errors import ZooError\n"
        f"{READERS[reader]}\n"
        "try:\n    read(Path(sys.argv[1]))\n"
        "except ZooError as error:\n    print(len(str(error)))\n"
        # Not getrusage's: that is the starting process's as well, which holds the whole test run.
        "peak = re.search(r'VmHWM:\\s+(\\d+) kB', Path('/proc/self/status').read_text())\n"
        "print(int(peak[1]) * 1024)"
    )
    words = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, cwd=ROOT)
    sizes = [int(line) for line in done.stdout.split()]
    assert len(sizes) == 2 and sizes[0] < 2000, done.stderr[-500:]
    assert sizes[1] < LIMIT


def test_many_keys_that_stand_twice_are_no_trap() -> None:
    text = '{"a": 0, ' + ", ".join(f'"k{n}": 0, "k{n}": 0' for n in range(20_000)) + "}"
    began = time.process_time()
    with pytest.raises(RegistryError, match="stands twice in one object"):
        parse_registry(text, "test")
    assert time.process_time() - began < 2


def test_a_damaged_teams_file_is_named(tmp_path: Path) -> None:
    for damage in (b"\xff\xfe[", b"[{", b"{}", b"[0]", b'[{"team": {}, "team": {}}]'):
        (tmp_path / "teams.json").write_bytes(damage)
        with pytest.raises(FormatError, match=r"teams\.json"):
            read_run(tmp_path)


def test_long_value_is_cut_before_formatting() -> None:
    assert len(shorten([0] * 10**7)) < 200 and len(shorten("x" * 10**7)) < 400


def test_escapes_and_links_do_not_leave_a_card(registry: Registry, capsys) -> None:
    evil = "\x1b]0;owned\x07 [click](javascript:alert(1)) <script>"
    notes = {"remark": evil, "\x1b[31m": 1}
    noted = registry.data.runs["scratch-ippo"].model_copy(update={"notes": notes})
    data = registry.data.model_copy(update={"runs": {"scratch-ippo": noted}})
    registry.path.unlink()
    loaded = save_registry(data, registry.path)
    text = markdown_card(find_cards(loaded, "scratch/ippo-d1-s0-v0"))
    assert "\x1b" not in text and "\\[click\\](javascript" in text and "<script" not in text
    assert run(["show", "scratch/ippo-d1-s0-v0", "--registry", str(registry.path)]) == 0
    shown = capsys.readouterr().out
    assert "owned" in shown and "\x1b" not in shown and "\x07" not in shown


def test_a_server_that_sends_a_byte_a_second_is_left(bare: Registry, hub: Hub, monkeypatch) -> None:
    monkeypatch.setattr(parallel, "SLACK", 0.5)
    monkeypatch.setattr(parallel, "SLOWEST", 10_000_000)
    hub.faults = [Fault("GET .*safetensors", pause=0.1, slice=1)]
    with pytest.raises(RemoteError, match="no end within"):  # the whole file would take a day
        fetch(bare, bare.policies, open_remote("hf://org/zoo"))


def test_an_interrupt_does_not_wait_for_a_server_that_hangs(bare: Registry, hub: Hub) -> None:
    hub.faults = [Fault("GET .*safetensors", pause=60)]
    words = ["fetch", "--from", "hf://org/zoo", "--registry", str(bare.path)]
    environment = {**os.environ, "HF_ENDPOINT": hub.url}
    with subprocess.Popen(
        [sys.executable, "-m", "assistax_zoo", *words], cwd=ROOT, env=environment
    ) as process:
        wait_for(lambda: hub.count("GET .*safetensors") > 0)
        time.sleep(0.5)  # until the main thread waits as well
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=50) == 130  # 2 s on a machine that is idle; the server takes 60


def test_old_partial_file_is_removed(bare: Registry, cache: Path) -> None:
    old = cached_shard("a" * 64).with_name(f".{'a' * 64}.safetensors.partial")
    old.parent.mkdir(parents=True)
    for age, left in ((0.0, True), (8 * 24 * 3600.0, False)):
        old.write_bytes(b"half")
        os.utime(old, (time.time() - age, time.time() - age))
        fetch(bare, bare.policies, open_remote("hf://org/zoo"))
        assert old.exists() == left
        for path in old.parent.glob("*.safetensors"):
            path.unlink()
