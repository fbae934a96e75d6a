"""Eighty kinds of web servers that misbehave: the true bytes arrive, or one line says why not."""

import gzip
import itertools
from pathlib import Path

import pytest

from assistax_base import parallel
from assistax_base.digest import sha256
from assistax_base.errors import ZooError
from tests.attack import web_server
from tests.attack.ledger import Ledger, attack
from tests.attack.web_server import Misbehave, answer, changed, endless, plain, raw, serving
from zoo.registry import Registry, load_registry
from zoo.transport import remotes
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import fetch, remote_registry

STATUSES = (100, 101, 103, 201, 202, 203, 204, 205, 206, 226, 300, 301, 302, 303, 304, 305, 307)
STATUSES += (308, 399, 400, 401, 402, 403, 404, 405, 406, 407, 408, 409, 410, 411, 413, 414, 415)
STATUSES += (416, 417, 418, 421, 422, 423, 425, 426, 429, 431, 451, 499, 500, 501, 502, 503, 504)
STATUSES += (505, 511, 599, 600, 999)
OK = b"HTTP/1.1 200 OK\r\n"


def redirect(to: str) -> Misbehave:
    return answer(b"", "302 Found", f"Location: {to}")


def headers(*lines: str) -> Misbehave:
    return answer(None, "200 OK", *lines)


def lengths(text: str) -> Misbehave:
    return answer(None, "200 OK", f"Content-Length: {text}", length=False)


def ranges(text: str) -> Misbehave:
    return answer(None, "206 Partial Content", f"Content-Range: {text}")


KINDS: dict[str, Misbehave] = {
    **{f"status {code}": answer(b"{}", f"{code} X") for code in STATUSES},
    "redirect to itself": lambda c, r, d: redirect(r.split(b" ")[1].decode())(c, r, d),
    "redirect to a file": redirect("file:///etc/passwd"),
    "redirect to ftp": redirect("ftp://127.0.0.1/x"),
    "redirect to nowhere": redirect("http://127.0.0.1:1/x"),
    "redirect to a port that is none": redirect("http://127.0.0.1:99999999/x"),
    "redirect without a place": answer(b"", "302 Found"),
    "redirect with control characters": redirect("/\x1b]0;owned\x07"),
    "retry after a year": answer(b"", "503 X", "Retry-After: 31536000"),
    "retry after minus one": answer(b"", "503 X", "Retry-After: -1"),
    "length minus one": lengths("-1"),
    "length of 2**64": lengths(str(2**64)),
    "length in words": lengths("many"),
    "two lengths": answer(None, "200 OK", "Content-Length: 3"),
    "no length": answer(None, length=False),
    "length too short": lengths("7"),
    "length too long": lengths("99999999"),
    "another range": ranges("bytes 5-9/10"),
    "a range of lies": ranges("bytes 0-0/1"),
    "a range of nonsense": ranges("pages one to nine"),
    "ranges without end": ranges(f"bytes 0-{10**30}/*"),
    "gzip that is none": headers("Content-Encoding: gzip"),
    "gzip bomb": answer(gzip.compress(bytes(1 << 26)), "200 OK", "Content-Encoding: gzip"),
    "unknown encoding": headers("Content-Encoding: rot13, br, zstd, zstd"),
    "chunks that are none": headers("Transfer-Encoding: chunked"),
    "a chunk of 2**63": raw(OK, b"Transfer-Encoding: chunked\r\n\r\n", b"8000000000000000\r\nx"),
    "a chunk of minus one": raw(OK, b"Transfer-Encoding: chunked\r\n\r\n", b"-1\r\nx\r\n"),
    "endless chunk header": endless(OK + b"Transfer-Encoding: chunked\r\n\r\n", b"0" * 4096),
    "endless header": endless(OK + b"X: ", b"x" * 65536),
    "endless headers": endless(OK, b"X: y\r\n" * 1000),
    "endless 100": endless(b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 100),
    "endless body": endless(OK + b"\r\n", bytes(1 << 20)),
    "endless chunks": endless(
        OK + b"Transfer-Encoding: chunked\r\n\r\n", b"100000\r\n" + bytes(1 << 20) + b"\r\n"
    ),
    "a byte now and then": endless(OK + b"Content-Length: 100000\r\n\r\n", b"x", 0.1),
    "a header byte now and then": endless(OK, b"x", 0.1),
    "header with NUL": headers("X: a\x00b"),
    "header with an escape": headers("Content-Type: \x1b[31mred"),
    "header without a name": headers(": x"),
    "two types": headers("Content-Type: a", "Content-Type: b"),
    "no HTTP": raw(b"hello\r\n\r\n"),
    "HTTP 0.9": lambda c, r, d: c.sendall(d),
    "HTTP 2": raw(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"),
    "TLS": raw(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(300)),
    "silence": lambda c, r, d: None,
    "a reset": web_server.reset,
    "empty": changed(lambda data: b""),
    "one byte": changed(lambda data: data[:1]),
    "half": changed(lambda data: data[: len(data) // 2]),
    "one byte more": changed(lambda data: data + b"x"),
    "a flipped bit": changed(lambda data: data[:50] + bytes([data[50] ^ 1]) + data[51:]),
    "the end flipped": changed(lambda data: data[:-1] + bytes([data[-1] ^ 1])),
    "reversed": changed(lambda data: data[::-1]),
    "zeros": changed(lambda data: bytes(len(data))),
    "twice": changed(lambda data: data + data),
    "a page": answer(b"<!doctype html><title>Log in</title>"),
    "JSON null": answer(b"null"),
    "deep JSON": answer(b"[" * 1_000_000),
    "60 MB of zeros": answer(bytes(60_000_000)),
}


def check(kind: str, true: Registry, cache: Path, registry_too: bool) -> str:
    """Fetch from a server; return "fetched" or the refusal."""
    files = {"registry.json": true.path.read_bytes()}
    files |= {Path(path).name: true.shard_path(path).read_bytes() for path in true.data.shards}
    expected = {sha256(data) for data in files.values()}

    def misbehave(connection, request, data):
        wrong = registry_too or b"registry.json" not in request.split(b"\r\n")[0]
        (KINDS[kind] if wrong else plain)(connection, request, data)

    with serving(files, misbehave) as server:
        remote = open_remote(server.url)
        try:
            received = remote_registry(remote)
            fetch(received, received.policies, remote)
            outcome = "fetched"
        except ZooError as error:
            outcome = str(error)
            assert outcome.isprintable() and len(outcome) < 2000, outcome
    kept = [path for path in cache.rglob("*") if path.is_file() and path.stat().st_size]
    visible = [path for path in kept if not path.name.startswith(".")]
    assert all(sha256(path.read_bytes()) in expected for path in visible), visible
    assert (outcome == "fetched") <= (len(visible) >= len(files)), outcome
    return outcome


def attack_with(ledger: Ledger, registry: Registry, folder: Path, patch: pytest.MonkeyPatch) -> int:
    """Try a share of the kinds on the registry and on the shards; return how often it came."""
    cases = list(itertools.product(KINDS, (True, False)))
    ledger.random.shuffle(cases)
    fetched = 0
    for number, (kind, registry_too) in enumerate(cases[: ledger.wanted(len(cases))]):
        cache = folder / str(number)
        patch.setenv("ASSISTAX_ZOO_CACHE", str(cache))
        with ledger.trial(f"{kind}, {'registry' if registry_too else 'shards'}"):
            fetched += check(kind, registry, cache, registry_too) == "fetched"
    return fetched


@pytest.mark.attack
def test_servers_that_misbehave(
    registry_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from huggingface_hub import constants

    monkeypatch.setattr(remotes, "RETRY", remotes.Retry(attempts=2, pause=0.01, longest=0.05))
    monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 1.0)
    monkeypatch.setattr(parallel, "SLACK", 3.0)
    monkeypatch.setattr(parallel, "SLOWEST", 10_000_000)
    true = load_registry(registry_path)
    with attack("web servers") as ledger:
        assert len(KINDS) >= 80
        attack_with(ledger, true, tmp_path, monkeypatch)
        cache = tmp_path / "good"
        monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(cache))
        KINDS["good"] = plain
        assert check("good", true, cache, True) == "fetched"
