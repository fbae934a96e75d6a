"""A hub on loopback for the real huggingface_hub client, with faults on demand."""

import base64
import contextlib
import dataclasses
import hashlib
import json
import re
import threading
import time
import urllib.parse
from collections.abc import Generator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

CHUNK = 1 << 20
Files = dict[str, bytes]


@dataclasses.dataclass
class Repository:
    kind: str = "model"
    commits: dict[str, Files] = dataclasses.field(default_factory=dict)
    branches: dict[str, str] = dataclasses.field(default_factory=dict)
    tags: dict[str, str] = dataclasses.field(default_factory=dict)

    def commit(self, files: Files, branch: str = "main") -> str:
        oid = hashlib.sha1(f"{len(self.commits)} {sorted(files)}".encode()).hexdigest()
        self.commits[oid] = files
        self.branches[branch] = oid
        return oid

    def resolve(self, revision: str) -> str | None:
        revisions = self.branches.get(revision) or self.tags.get(revision)
        return revisions or (revision if revision in self.commits else None)


@dataclasses.dataclass
class Fault:
    """What happens to the next requests whose method and path match."""

    match: str  # regular expression over "GET /org/name/resolve/..."
    status: int | None = None  # answer with it
    cut: int | None = None  # promise the whole body, close the connection after so many bytes
    short: int | None = None  # a body of so many bytes that looks complete
    flip: int | None = None  # flip a bit of the byte at this offset of the file
    longer: bytes = b""  # added to the body
    pause: float = 0.0  # seconds before the body, and after each `slice` of it
    slice: int = CHUNK
    whole: bool = False  # ignore ranges
    lose_answer: bool = False  # do what is asked, then close the connection
    times: int = 10**9
    headers: dict[str, str] = dataclasses.field(default_factory=dict)


class Hub(ThreadingHTTPServer):
    """The server; `url` is its endpoint, `log` every request."""

    daemon_threads = True
    block_on_close = False

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.repositories: dict[str, Repository] = {}
        self.large: Files = {}  # uploaded, by sha256
        self.faults: list[Fault] = []
        self.log: list[str] = []
        self.upload_mode = "regular"
        self.lock = threading.Lock()
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.thread = threading.Thread(
            target=self.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True
        )

    def put(self, name: str, folder: Path, kind: str = "model", tag: str | None = None) -> str:
        """Commit a folder to a repository, and return the commit."""
        repository = self.repositories.setdefault(name, Repository(kind))
        files = {
            str(path.relative_to(folder)): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file()
        }
        with self.lock:
            oid = repository.commit(files)
            if tag:
                repository.tags[tag] = oid
        return oid

    def count(self, pattern: str) -> int:
        return sum(re.search(pattern, line) is not None for line in self.log)

    @contextlib.contextmanager
    def running(self) -> Generator["Hub"]:
        self.thread.start()
        try:
            yield self
        finally:
            self.shutdown()
            self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Stay quiet about clients that go away."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    @property
    def hub(self) -> Hub:
        assert isinstance(self.server, Hub)
        return self.server

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def do_GET(self) -> None:
        self._serve()

    do_HEAD = do_POST = do_PUT = do_GET

    def _serve(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        self.body = self.rfile.read(length) if length else b""
        self.route = urllib.parse.unquote(urllib.parse.urlsplit(self.path).path)
        request = f"{self.command} {self.route}"
        with self.hub.lock:
            self.hub.log.append(f"{request} {self.headers.get('Range', '')}".rstrip())
            self.fault = next(
                (f for f in self.hub.faults if f.times > 0 and re.search(f.match, request)),
                Fault(""),
            )
            self.fault.times -= 1
        if self.fault.status:
            return self._answer({"error": "planned"}, self.fault.status, self.fault.headers)
        for method, pattern, handle in _ROUTES:
            match = re.fullmatch(pattern, self.route)
            if match and self.command in method.split("|"):
                return handle(self, **match.groupdict())
        return self._answer({"error": "no such route"}, 404)

    def _repository(self, repo: str, kind: str = "model") -> Repository | None:
        repository = self.hub.repositories.get(repo)
        if repository is None or repository.kind != kind:
            self._missing("RepoNotFound")
            return None
        return repository

    def _missing(self, code: str) -> None:
        self._answer({"error": "missing"}, 404, {"X-Error-Code": code})

    def info(self, kind: str, repo: str, revision: str | None = None) -> None:
        if repository := self._repository(repo, kind):
            oid = repository.resolve(revision or "main")
            if oid is None:
                return self._missing("RevisionNotFound")
            siblings = [{"rfilename": name} for name in repository.commits[oid]]
            about = {"id": repo, "sha": oid, "siblings": siblings, "tags": [], "private": False}
            self._answer(about)
        return None

    def refs(self, kind: str, repo: str) -> None:
        if repository := self._repository(repo, kind):
            tables = {"branches": ("heads", repository.branches), "tags": ("tags", repository.tags)}
            answer: dict[str, Any] = {"converts": []}
            for name, (folder, table) in tables.items():
                answer[name] = [
                    {"name": n, "ref": f"refs/{folder}/{n}", "targetCommit": o}
                    for n, o in table.items()
                ]
            self._answer(answer)

    def create(self) -> None:
        body = json.loads(self.body)
        name = f"{body['organization']}/{body['name']}"
        if name in self.hub.repositories:
            return self._answer({"error": "exists", "url": f"{self.hub.url}/{name}"}, 409)
        repository = self.hub.repositories[name] = Repository(body.get("type") or "model")
        repository.commit({".gitattributes": b"*.safetensors filter=lfs\n"})
        return self._answer({"url": f"{self.hub.url}/{name}"})

    def validate(self) -> None:
        self._answer({"errors": [], "warnings": []})

    def preupload(self, repo: str, revision: str) -> None:
        mode = self.hub.upload_mode
        files = [
            {
                "path": file["path"],
                "uploadMode": mode if file["path"].endswith(".safetensors") else "regular",
                "shouldIgnore": False,
            }
            for file in json.loads(self.body)["files"]
        ]
        self._answer({"files": files})

    def batch(self, repo: str) -> None:
        objects = [
            {**entry, "actions": {"upload": {"href": f"{self.hub.url}/lfs/{entry['oid']}"}}}
            for entry in json.loads(self.body)["objects"]
        ]
        self._answer({"transfer": "basic", "objects": objects})

    def upload(self, oid: str) -> None:
        if hashlib.sha256(self.body).hexdigest() != oid:
            return self._answer({"error": "wrong sha256"}, 400)
        self.hub.large[oid] = self.body
        return self._answer({})

    def commit(self, repo: str, revision: str) -> None:
        repository = self._repository(repo)
        if repository is None:
            return None
        lines = [json.loads(line) for line in self.body.splitlines()]
        with self.hub.lock:
            head = repository.branches[revision]
            if lines[0]["value"].get("parentCommit", head) != head:
                return self._answer({"error": "A commit has happened since"}, 412)
            files = dict(repository.commits[head])
            for line in lines[1:]:
                value = line["value"]
                large = line["key"] == "lfsFile"
                files[value["path"]] = (
                    self.hub.large[value["oid"]] if large else base64.b64decode(value["content"])
                )
            oid = repository.commit(files, revision)
        return self._answer({"commitUrl": f"{self.hub.url}/{repo}/commit/{oid}", "commitOid": oid})

    def tag(self, repo: str, revision: str) -> None:
        if repository := self._repository(repo):
            name, oid = json.loads(self.body)["tag"], repository.resolve(revision)
            if oid is None or name in repository.tags:
                return self._answer({"error": "tag exists"}, 409)
            repository.tags[name] = oid
            self._answer({})
        return None

    def file(self, repo: str, revision: str, path: str) -> None:
        if repository := self._repository(repo):
            oid = repository.resolve(revision)
            if oid is None:
                return self._missing("RevisionNotFound")
            data = repository.commits[oid].get(path)
            if data is None:
                return self._missing("EntryNotFound")
            self._send_file(data)
        return None

    def _send_file(self, data: bytes) -> None:
        fault = self.fault
        if fault.flip is not None:
            data = data[: fault.flip] + bytes([data[fault.flip] ^ 1]) + data[fault.flip + 1 :]
        data += fault.longer
        start, stop, status = 0, len(data), 200
        match = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        if match and not fault.whole:
            start, stop, status = int(match[1]), int(match[2]) + 1 if match[2] else len(data), 206
            if start >= len(data):
                whole = {"Content-Range": f"bytes */{len(data)}"}
                return self._answer({"error": "range"}, 416, whole)
        body = memoryview(data)[start:stop]
        body = body if fault.short is None else body[: fault.short]
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        if status == 206:
            self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{len(data)}")
        self.end_headers()
        time.sleep(fault.pause)
        if self.command == "GET":
            self._send_body(body if fault.cut is None else body[: fault.cut])
        return None

    def _send_body(self, body: memoryview) -> None:
        for begin in range(0, len(body), self.fault.slice):
            self.wfile.write(body[begin : begin + self.fault.slice])
            time.sleep(self.fault.pause)
        if self.fault.cut is not None:
            self.close_connection = True

    def _answer(self, value: Any, status: int = 200, headers: dict[str, str] | None = None) -> None:
        time.sleep(self.fault.pause)
        if self.fault.lose_answer:
            self.close_connection = True
            return
        data = json.dumps(value).encode()
        self.send_response(status)
        for name, text in {"Content-Type": "application/json", **(headers or {})}.items():
            self.send_header(name, text)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)


_REPO = r"(?P<repo>[\w.-]+/[\w.-]+)"
_ROUTES = [
    ("GET", rf"/api/(?P<kind>\w+)s/{_REPO}", _Handler.info),
    ("GET", rf"/api/(?P<kind>\w+)s/{_REPO}/revision/(?P<revision>.+)", _Handler.info),
    ("GET", rf"/api/(?P<kind>\w+)s/{_REPO}/refs", _Handler.refs),
    ("POST", "/api/repos/create", _Handler.create),
    ("POST", "/api/validate-yaml", _Handler.validate),
    ("POST", rf"/api/models/{_REPO}/preupload/(?P<revision>.+)", _Handler.preupload),
    ("POST", rf"/api/models/{_REPO}/commit/(?P<revision>.+)", _Handler.commit),
    ("POST", rf"/api/models/{_REPO}/tag/(?P<revision>.+)", _Handler.tag),
    ("POST", rf"/{_REPO}\.git/info/lfs/objects/batch", _Handler.batch),
    ("PUT", r"/lfs/(?P<oid>[0-9a-f]{64})", _Handler.upload),
    ("GET|HEAD", rf"/{_REPO}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", _Handler.file),
]
