"""Upload to and download from a model hub, by the library of the hub (`huggingface_hub`).

The address of another server is in HF_ENDPOINT, the token in HF_TOKEN or where `hf auth login` keeps it. A repository
is private unless the user says otherwise. What is downloaded is of one commit, and is compared with the digests that
the hub lists for this commit. A hub is not trusted: these digests only show that nothing was damaged on the way.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from embodied_depth_trainer.errors import TrainerError

if TYPE_CHECKING:
    from huggingface_hub import HfApi

Kind = Literal["model", "dataset"]
REASON_CHARACTERS = 400


@dataclass(frozen=True)
class Repository:
    """A repository of a hub."""

    name: str
    """OWNER/NAME."""
    kind: Kind

    def __str__(self) -> str:
        return f"the {self.kind} repository {self.name}"


@dataclass(frozen=True)
class Digest:
    """What a hub says about the bytes of a file."""

    algorithm: Literal["sha256", "git"]
    """SHA-256 of a large file; of others the name of Git's blob."""
    value: str

    def of(self, file: Path) -> str:
        """The digest of a file by the same algorithm."""
        found = hashlib.sha256() if self.algorithm == "sha256" else hashlib.sha1(b"blob %d\0" % file.stat().st_size)
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                found.update(block)
        return found.hexdigest()


@dataclass(frozen=True)
class Uploaded:
    """What an upload has led to."""

    commit: str
    is_private: bool
    """A repository that existed before keeps its visibility."""


@dataclass(frozen=True)
class Snapshot:
    """One commit of a repository."""

    repository: Repository
    commit: str
    digests: Mapping[str, Digest]
    """By the paths of the files."""

    def check(self, name: str, file: Path) -> None:
        """Refuses a file that is not what the hub lists."""
        expected = self.digests[name]
        if (found := expected.of(file)) != expected.value:
            raise TrainerError(
                f"{file} has the digest {found}, but the hub lists {expected.value} for it ({expected.algorithm}); "
                "remove it and run the same command again"
            )


def upload(repository: Repository, folder: Path, public: bool, replaced: Sequence[str] = ()) -> Uploaded:
    """Uploads a folder as one state of the repository; files whose names match `replaced` and that are not in the
    folder are removed from it."""
    api = _api()
    with _explained(f"upload to {repository}"):
        _need_token(repository)
        api.create_repo(repository.name, repo_type=repository.kind, private=not public, exist_ok=True)
        is_private = api.repo_info(repository.name, repo_type=repository.kind).private is True
        if not is_private and not public:
            raise TrainerError(
                f"{repository} is public already and nothing was uploaded; give --public to publish there, or another "
                "repository"
            )
        done = api.upload_folder(
            repo_id=repository.name,
            repo_type=repository.kind,
            folder_path=folder,
            commit_message="Upload by embodied-depth",
            delete_patterns=list(replaced) or None,
        )
    return Uploaded(str(done.oid), is_private)


def snapshot(repository: Repository, revision: str) -> Snapshot:
    """The commit that a branch, a tag or a commit names now, and its files."""
    api = _api()
    from huggingface_hub.hf_api import RepoFile

    with _explained(f"read {repository} at {revision}"):
        commit = api.repo_info(repository.name, repo_type=repository.kind, revision=revision).sha
        assert commit is not None
        tree = api.list_repo_tree(repository.name, repo_type=repository.kind, revision=commit, recursive=True)
        files = [item for item in tree if isinstance(item, RepoFile)]
    large = {file.path: Digest("sha256", file.lfs.sha256) for file in files if file.lfs is not None}
    digests = {file.path: Digest("git", file.blob_id) for file in files} | large
    return Snapshot(repository, commit, digests)


def download_file(found: Snapshot, name: str, folder: Path) -> Path:
    """Downloads one file of a commit, and compares it with its digest."""
    with _explained(f"download {name} of {found.repository}"):
        file = Path(
            _api().hf_hub_download(
                found.repository.name, name, repo_type=found.repository.kind, revision=found.commit, local_dir=folder
            )
        )
    found.check(name, file)
    return file


def download_all(found: Snapshot, patterns: Sequence[str], folder: Path) -> None:
    """Downloads the files of a commit whose names match a pattern. What is there already is not downloaded again."""
    with _explained(f"download {found.repository}"):
        _api().snapshot_download(
            found.repository.name,
            repo_type=found.repository.kind,
            revision=found.commit,
            allow_patterns=list(patterns),
            local_dir=folder,
        )


def _api() -> HfApi:
    # Must be set before the library is loaded.
    os.environ.setdefault("HF_HUB_DISABLE_TELEMETRY", "1")
    try:
        from huggingface_hub import HfApi
    except ImportError:
        raise TrainerError("a hub needs the package huggingface_hub; run `pip install huggingface_hub`") from None
    return HfApi(endpoint=os.environ.get("HF_ENDPOINT"), library_name="embodied-depth")


def _need_token(repository: Repository) -> None:
    from huggingface_hub import get_token

    if get_token() is None:
        raise TrainerError(
            f"there is no token to write to {repository}; set HF_TOKEN to a token with the right to write, or run "
            "`hf auth login`"
        )


@contextmanager
def _explained(what: str) -> Iterator[None]:
    try:
        yield
    except TrainerError:
        raise
    except Exception as problem:
        # The library passes on the errors of its HTTP client, which is another one in each major version.
        reason = " ".join(str(problem).split())[:REASON_CHARACTERS] or type(problem).__name__
        raise TrainerError(f"cannot {what}: {reason}; {_way_out(problem)}") from None


def _way_out(problem: Exception) -> str:
    """What to do about an error of the library."""
    from huggingface_hub import errors

    status = getattr(getattr(problem, "response", None), "status_code", None)
    if isinstance(problem, errors.HFValidationError):
        return "a repository is named OWNER/NAME, with letters, digits, `-`, `_` and `.`"
    if isinstance(problem, errors.GatedRepoError):
        return "ask its owner for access, and set HF_TOKEN"
    if isinstance(problem, errors.RevisionNotFoundError):
        return "give another --revision"
    if isinstance(problem, errors.RepositoryNotFoundError):
        return "check its name and --type; a private repository needs a token (HF_TOKEN, or `hf auth login`)"
    if status == 401:
        return "the token is not accepted; set HF_TOKEN to a valid one, or run `hf auth login`"
    if status in (402, 403):
        return (
            "the hub refuses it: the token needs the right to write for this owner, and the owner must be allowed "
            "another repository of this kind (a plan may limit private ones; --public publishes)"
        )
    return "check the connection and HF_ENDPOINT, and run the same command again: what is done is kept"
