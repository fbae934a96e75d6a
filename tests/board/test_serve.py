"""Where a server listens: on every address of its host."""

import contextlib
import gc
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import httpx2
import pytest

from assistax_board import serve
from assistax_board.commands.serving import serve as command
from tests.board.fakes import new_service
from tests.board.running import port_of_its_own, served

ELSEWHERE = "2001:db8::1"  # an address of documentation: no machine's


def name(monkeypatch: pytest.MonkeyPatch, *addresses: str) -> None:
    """Give localhost these addresses, whatever they are on this machine."""
    resolve = socket.getaddrinfo

    def getaddrinfo(host: Any, *words: Any, **options: Any) -> list[Any]:
        hosts = addresses if host == "localhost" else [host]
        return [found for each in hosts for found in resolve(each, *words, **options)]

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)


@pytest.fixture
def ipv6() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("needs IPv6")


def test_server_answers_on_every_host_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ipv6: None
) -> None:
    name(monkeypatch, "::1", "127.0.0.1", "127.0.0.1")
    monkeypatch.setattr(serve, "stop_limited", lambda: None)  # it would be for good

    def kind(config: Any) -> Any:
        return serve._Server(config, lambda: None)  # private: what `serve` runs

    with served(new_service(tmp_path), kind=kind, host="localhost") as server:
        for address in ("127.0.0.1", "[::1]"):
            health = server.address.replace("127.0.0.1", address) + "/api/health"
            assert httpx2.get(health).status_code == 200
    gc.unfreeze()


def test_server_skips_missing_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    name(monkeypatch, ELSEWHERE, "127.0.0.1")
    with serve.listen("localhost", 0) as (_, listeners):
        assert [listener.getsockname()[0] for listener in listeners] == ["127.0.0.1"]
    with pytest.raises(ValueError, match="cannot listen on 2001:db8::1:0 "):
        serve.listen(ELSEWHERE, 0).__enter__()


def test_port_taken_on_one_address_is_refused(monkeypatch: pytest.MonkeyPatch, ipv6: None) -> None:
    name(monkeypatch, "127.0.0.1", "::1")
    with (
        socket.create_server(("::1", port_of_its_own()), family=socket.AF_INET6) as taken,
        pytest.raises(ValueError, match=r"in use .*::1.*; choose another port"),
        serve.listen("localhost", taken.getsockname()[1]),
    ):
        pass


def test_printed_free_port_stays_reserved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was given back and taken again later, when the workers knew it."""
    service, ran = new_service(tmp_path), []

    def run_server(*_: Any, **__: Any) -> None:
        said = capsys.readouterr().err
        ran.append(int(said.split("serving http://127.0.0.1:")[1].split()[0]))
        with pytest.raises(OSError, match="in use"):
            socket.create_server(("127.0.0.1", ran[0]))

    monkeypatch.setattr(serve, "open_service", lambda *_, **__: service)
    monkeypatch.setattr(serve, "stopped_by_signals", contextlib.nullcontext)
    monkeypatch.setattr(serve, "run_server", run_server)
    command(data=tmp_path / "board", port=0, workers=0, references=False)
    assert ran[0] > 0


def test_a_folder_has_one_server(tmp_path: Path) -> None:
    data = tmp_path / "board"
    with serve.only_server(data), pytest.raises(ValueError, match="another server runs"):
        command(data=data, port=0, workers=0, references=False)
    with serve.only_server(data):
        pass


COUNT_ARENAS = """
import ctypes, sys, threading
from assistax_board.serve import limit_arenas
if sys.argv[1] == "limited":
    limit_arenas()
c = ctypes.CDLL(None)
c.malloc.restype = c.fopen.restype = ctypes.c_void_p
def report(name):
    file = ctypes.c_void_p(c.fopen(name.encode(), b"w"))
    c.malloc_info(0, file)
    c.fclose(file)
report(sys.argv[2])  # libraries may have begun threads
together = threading.Barrier(12)
def fill():
    together.wait()
    c.malloc(5000)
    together.wait()
threads = [threading.Thread(target=fill) for _ in range(12)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
report(sys.argv[3])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's malloc has arenas")
@pytest.mark.parametrize("how", ["limited", "usual"])
def test_threads_get_no_arenas_of_their_own(tmp_path: Path, how: str) -> None:
    reports = tmp_path / "before.xml", tmp_path / "after.xml"
    subprocess.run([sys.executable, "-c", COUNT_ARENAS, how, *reports], check=True)
    before, after = (report.read_text().count("<heap nr=") for report in reports)
    assert before > 0
    assert (after <= max(before, serve.ARENAS)) == (how == "limited"), (before, after)
