"""A model hub in this process: the requests of `huggingface_hub` that `embodied-depth hub` leads to, and no others."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatch
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

TOKEN = "hf_of_the_test"
# Names of files that the hub keeps as large files, with a SHA-256.
LARGE = ("*.onnx", "*.npy")
# Types of bodies that are one value in JSON.
PLAIN = ("application/json", "application/vnd.git-lfs+json")
Files = dict[str, bytes]


@dataclass
class Repo:
    private: bool
    commits: dict[str, Files] = field(default_factory=dict)
    """All states by their names, the last one is `main`."""

    def add(self, files: Files) -> str:
        listed = sorted((name, hashlib.sha1(data).hexdigest()) for name, data in files.items())
        commit = hashlib.sha1(json.dumps([len(self.commits), listed]).encode()).hexdigest()
        self.commits[commit] = files
        return commit

    def at(self, revision: str) -> str | None:
        """The commit of a revision."""
        return list(self.commits)[-1] if revision == "main" else revision if revision in self.commits else None


@dataclass
class FakeHub:
    """What the hub has, and how it misbehaves."""

    repos: dict[tuple[str, str], Repo] = field(default_factory=dict)
    """By kind and name."""
    large: dict[str, bytes] = field(default_factory=dict)
    """Large files by their SHA-256."""
    refuses_private: bool = False
    has_large_files: bool = True
    damaged: set[str] = field(default_factory=set)
    """Paths of files that it sends with another last byte."""
    address: str = ""

    def make(self, kind: str, name: str, private: bool, files: Files | None = None) -> Repo:
        self.repos[kind, name] = repo = Repo(private)
        repo.add(files or {".gitattributes": b""})
        return repo

    def is_large(self, path: str) -> bool:
        return self.has_large_files and any(fnmatch(path, pattern) for pattern in LARGE)

    @contextmanager
    def serve(self) -> Iterator[FakeHub]:
        hub = self

        class Handler(_Handler):
            state = hub

        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{server.server_address[1]}"
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield self
        finally:
            server.shutdown()
            server.server_close()
            thread.join()


class _RefusedError(Exception):
    def __init__(self, status: int, code: str = "", message: str = "", content: dict[str, str] | None = None) -> None:
        self.status = status
        self.headers = {"X-Error-Code": code, "X-Error-Message": message}
        self.content = json.dumps(content or {}).encode()


class _Handler(BaseHTTPRequestHandler):
    state: FakeHub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Nothing: pytest shows what a test prints."""

    def do_GET(self) -> None:
        self._answer()

    do_HEAD = do_POST = do_PUT = do_GET  # noqa: N815

    def _answer(self) -> None:
        body = self._body()
        headers: dict[str, str] = {}
        try:
            status, content, headers = self._routed(unquote(urlsplit(self.path).path), body)
        except _RefusedError as refused:
            status, content, headers = refused.status, refused.content, refused.headers
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def _body(self) -> bytes:
        if self.headers.get("Transfer-Encoding") != "chunked":
            return self.rfile.read(int(self.headers.get("Content-Length") or 0))
        body = b""
        while size := int(self.rfile.readline(), 16):
            body += self.rfile.read(size)
            self.rfile.readline()
        self.rfile.readline()
        return body

    def _routed(self, path: str, body: bytes) -> tuple[int, bytes, dict[str, str]]:
        plain: dict[str, Any] = json.loads(body) if self.headers.get("Content-Type") in PLAIN else {}
        routes: tuple[tuple[str, str, Callable[..., object]], ...] = (
            ("POST", r"/api/repos/create", lambda: self._create(plain)),
            ("POST", r"/api/validate-yaml", lambda: {"errors": [], "warnings": []}),
            ("PUT", r"/large/(\w+)", lambda oid: self.state.large.update({oid: body}) or {}),
            ("POST", r"/(datasets/)?(\w+/[\w.-]+)\.git/info/lfs/objects/batch", lambda *_: self._batch(plain)),
            ("POST", r"/api/(\w+)s/(\w+/[\w.-]+)/preupload/main", lambda *at: self._modes(plain, *at)),
            ("POST", r"/api/(\w+)s/(\w+/[\w.-]+)/commit/main", lambda *at: self._commit(body, *at)),
            ("GET", r"/api/(\w+)s/(\w+/[\w.-]+)(?:/revision/([\w.-]+))?", self._info),
            ("GET", r"/api/(\w+)s/(\w+/[\w.-]+)/tree/([\w.-]+)", self._tree),
        )
        for method, pattern, answer in routes:
            if method == self.command and (match := re.fullmatch(pattern, path)):
                return 200, json.dumps(answer(*match.groups())).encode(), {"Content-Type": "application/json"}
        if match := re.fullmatch(r"/(datasets/)?(\w+/[\w.-]+)/resolve/([\w.-]+)/(.+)", path):
            return self._file("dataset" if match[1] else "model", *match.groups()[1:])
        raise _RefusedError(404, message=f"the fake hub does not know {self.command} {path}")

    def _may(self, write: bool, private: bool) -> None:
        said = self.headers.get("Authorization")
        if said is not None and said != f"Bearer {TOKEN}":
            raise _RefusedError(401, message="Invalid credentials in Authorization header")
        if said is None and (write or private):
            raise _RefusedError(401, "RepoNotFound", "Repository not found")

    def _repo(self, kind: str, name: str, write: bool = False) -> Repo:
        repo = self.state.repos.get((kind, name))
        self._may(write, repo is None or repo.private)
        if repo is None:
            raise _RefusedError(404, "RepoNotFound", "Repository not found")
        return repo

    def _at(self, kind: str, name: str, revision: str) -> tuple[str, Files]:
        repo = self._repo(kind, name)
        commit = repo.at(revision)
        if commit is None:
            raise _RefusedError(404, "RevisionNotFound", f"Invalid rev id: {revision}")
        return commit, repo.commits[commit]

    def _create(self, plain: dict[str, Any]) -> dict[str, str]:
        self._may(True, True)
        kind, name = plain.get("type", "model"), f"{plain['organization']}/{plain['name']}"
        if (kind, name) in self.state.repos:
            raise _RefusedError(409, content={"url": f"{self.state.address}/{name}"})
        # Earlier versions of the library send `private`.
        private = plain.get("visibility") == "private" or plain.get("private") is True
        if private and self.state.refuses_private:
            raise _RefusedError(403, message="Private repositories are not part of your plan")
        self.state.make(kind, name, private)
        return {"url": f"{self.state.address}/{'datasets/' if kind == 'dataset' else ''}{name}"}

    def _modes(self, plain: dict[str, Any], kind: str, name: str) -> dict[str, Any]:
        self._repo(kind, name, write=True)
        paths = [file["path"] for file in plain["files"]]
        modes = {path: "lfs" if self.state.is_large(path) else "regular" for path in paths}
        return {"files": [{"path": path, "uploadMode": mode, "shouldIgnore": False} for path, mode in modes.items()]}

    def _batch(self, plain: dict[str, Any]) -> dict[str, Any]:
        self._may(True, True)
        place = f"{self.state.address}/large"
        actions = [{**item, "actions": {"upload": {"href": f"{place}/{item['oid']}"}}} for item in plain["objects"]]
        return {"transfer": "basic", "objects": actions}

    def _commit(self, body: bytes, kind: str, name: str) -> dict[str, Any]:
        repo = self._repo(kind, name, write=True)
        files = dict(repo.commits[repo.at("main") or ""])
        for line in map(json.loads, body.splitlines()):
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.state.large[value["oid"]]
            elif line["key"] == "deletedFile":
                del files[value["path"]]
        commit = repo.add(files)
        return {"success": True, "commitOid": commit, "commitUrl": f"{self.state.address}/{name}/commit/{commit}"}

    def _info(self, kind: str, name: str, revision: str | None) -> dict[str, Any]:
        commit, files = self._at(kind, name, revision or "main")
        private = self.state.repos[kind, name].private
        siblings = [{"rfilename": path} for path in files]
        return {
            "id": name,
            "sha": commit,
            "private": private,
            "siblings": siblings,
            "tags": [],
            "downloads": 0,
            "likes": 0,
        }

    def _tree(self, kind: str, name: str, revision: str) -> list[dict[str, Any]]:
        _, files = self._at(kind, name, revision)
        assert parse_qs(urlsplit(self.path).query)["recursive"] == ["true"]
        folders = {path.rpartition("/")[0] for path in files} - {""}
        return [{"type": "directory", "path": path, "oid": "0" * 40, "size": 0} for path in sorted(folders)] + [
            {"type": "file", "path": path, "size": len(data), **self._digests(path, data)}
            for path, data in files.items()
        ]

    def _digests(self, path: str, data: bytes) -> dict[str, Any]:
        blob = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
        if not self.state.is_large(path):
            return {"oid": blob}
        digest = hashlib.sha256(data).hexdigest()
        # Git has a pointer in place of a large file.
        return {"oid": "1" * 40, "lfs": {"oid": digest, "size": len(data), "pointerSize": 134}}

    def _file(self, kind: str, name: str, revision: str, path: str) -> tuple[int, bytes, dict[str, str]]:
        commit, files = self._at(kind, name, revision)
        if path not in files:
            raise _RefusedError(404, "EntryNotFound", f"{path} does not exist")
        digests = self._digests(path, files[path])
        tag = digests.get("lfs", digests)["oid"]
        data = files[path]
        if path in self.state.damaged:
            data = data[:-1] + bytes([data[-1] ^ 1])
        return 200, data, {"X-Repo-Commit": commit, "ETag": f'"{tag}"', "Accept-Ranges": "none"}
