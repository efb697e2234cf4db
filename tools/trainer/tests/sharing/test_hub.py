"""A hub gets what the user names and nothing else, and what comes from it is checked."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest

from embodied_depth_trainer.commands.cli import main
from embodied_depth_trainer.store.dataset import open_dataset
from embodied_depth_trainer.store.listing import freeze, segments_of
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import read_version, write_version
from embodied_depth_trainer.training.initial import SHIPPED

from ..fake_hub import TOKEN, FakeHub
from ..rooms import room
from ..stores import record, store_of, without_coarse

pytest.importorskip("huggingface_hub")
MODEL = ("model", "workshop/student")
DATASET = ("dataset", "workshop/kitchen")


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[FakeHub]:
    """A hub, a token for it, and no file of the library outside of the test."""
    from huggingface_hub import constants

    with FakeHub().serve() as served:
        monkeypatch.setenv("HF_ENDPOINT", served.address)
        # What the library reads when it is loaded.
        monkeypatch.setattr(constants, "ENDPOINT", served.address)
        files = served.address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", files)
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no-token"))
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        # The library's other protocol needs a second server.
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_TELEMETRY", True)
        yield served


@pytest.fixture
def store(tmp_path: Path) -> Store:
    record(tmp_path / "runs/anna/monday", room(40), [24, 16])
    record(tmp_path / "runs/anna/tuesday", room(30, seed=1), [30])
    return without_coarse(tmp_path / "runs", tmp_path / "store")


def hub_main(*arguments: object) -> int:
    return main(["hub", *map(str, arguments)])


def failed(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The error of a command."""
    capsys.readouterr()
    assert hub_main(*arguments) == 1
    return capsys.readouterr().err


def changed(file: Path, to: Path, **metadata: str | None) -> Path:
    """A copy of a network with other metadata."""
    model = onnx.load(str(file))
    known = {entry.key: entry.value for entry in model.metadata_props}
    onnx.helper.set_model_props(model, {key: value for key, value in (known | metadata).items() if value is not None})
    onnx.save(model, str(to))
    return to


def wrong_golden_output() -> str:
    """The golden output of another network."""
    import base64

    return base64.b64encode(np.full((12, 40), 0.9, "<f4").tobytes()).decode()


def test_a_network_comes_back_as_the_same_bytes_with_its_card(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hub_main("upload", MODEL[1], SHIPPED, "--license", "mit") == 0
    repo = hub.repos[MODEL]
    commit = repo.at("main")
    assert f"commit {commit}, private" in capsys.readouterr().out
    assert repo.private
    assert hub_main("download", MODEL[1], "--out", tmp_path / "got") == 0
    said = capsys.readouterr().out
    digest = hashlib.sha256(SHIPPED.read_bytes()).hexdigest()
    assert f"commit {commit}\n" in said
    assert digest in said
    assert "no robot trusts it yet: `push-model" in said
    assert {file.name for file in (tmp_path / "got").iterdir()} == {"default.onnx", "README.md"}
    assert (tmp_path / "got/default.onnx").read_bytes() == SHIPPED.read_bytes()
    assert 'license: "mit"' in (tmp_path / "got/README.md").read_text()


def test_a_commit_is_the_same_network_after_another_upload(hub: FakeHub, tmp_path: Path) -> None:
    repo = hub.make(*MODEL, private=False, files={"net.onnx": SHIPPED.read_bytes()})
    first = repo.at("main")
    other = changed(SHIPPED, tmp_path / "net.onnx", version="another")
    assert hub_main("upload", MODEL[1], other, "--public") == 0
    assert hub_main("download", MODEL[1], "--revision", first, "--out", tmp_path / "first") == 0
    assert hub_main("download", MODEL[1], "--out", tmp_path / "now") == 0
    assert (tmp_path / "first/net.onnx").read_bytes() == SHIPPED.read_bytes()
    assert (tmp_path / "now/net.onnx").read_bytes() == other.read_bytes()


def test_a_network_that_was_damaged_on_the_way_is_refused(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hub.make(*MODEL, private=False, files={"net.onnx": SHIPPED.read_bytes()})
    hub.damaged.add("net.onnx")
    said = failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")
    assert f"the hub lists {hashlib.sha256(SHIPPED.read_bytes()).hexdigest()} for it (sha256)" in said
    assert list((tmp_path / "got").iterdir()) == []


def test_a_network_of_another_digest_than_expected_is_refused(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hub.make(*MODEL, private=False, files={"net.onnx": SHIPPED.read_bytes()})
    assert "expected 00ff" in failed(capsys, "download", MODEL[1], "--expect", "00ff", "--out", tmp_path / "got")
    assert list((tmp_path / "got").iterdir()) == []


@pytest.mark.parametrize(
    ("metadata", "why"),
    [
        ({"golden_output": wrong_golden_output()}, "differs from its golden output"),
        ({"golden_output": "!"}, "has no usable golden pair"),
        ({"golden_input": None}, "has no usable golden pair (KeyError('golden_input'))"),
        ({"kind": "text"}, "is no depth network of this trainer"),
    ],
)
def test_a_network_that_the_gate_would_refuse_does_not_appear(
    hub: FakeHub,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    metadata: dict[str, str | None],
    why: str,
) -> None:
    bad = changed(SHIPPED, tmp_path / "net.onnx", **metadata)
    hub.make(*MODEL, private=False, files={"net.onnx": bad.read_bytes()})
    assert why in failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")
    assert list((tmp_path / "got").iterdir()) == []
    # Neither is it uploaded.
    assert why in failed(capsys, "upload", "workshop/mine", bad)
    assert ("model", "workshop/mine") not in hub.repos


def test_operators_opsets_and_files_of_others_are_refused_before_the_network_is_loaded(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def loaded(*_: object) -> None:
        raise AssertionError("the network was loaded")

    monkeypatch.setattr("embodied_depth_trainer.sharing.examination.OnnxNetwork", loaded)

    def why(model: onnx.ModelProto) -> str:
        hub.make(*MODEL, private=False, files={"net.onnx": model.SerializeToString()})
        return failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")

    foreign = onnx.load(str(SHIPPED))
    foreign.opset_import.add(domain="com.microsoft", version=1)
    assert "needs operators of `com.microsoft`" in why(foreign)
    old = onnx.load(str(SHIPPED))
    old.opset_import[0].version = 9
    assert "has opset 9, accepted are 11 to 21" in why(old)
    outside = onnx.load(str(SHIPPED))
    weights = outside.graph.initializer[0]
    weights.ClearField("raw_data")
    weights.data_location = onnx.TensorProto.EXTERNAL
    weights.external_data.add(key="location", value="/etc/passwd")
    assert f"keeps the weights `{weights.name}` in another file" in why(outside)


def test_only_a_network_is_downloaded_and_never_over_another_file(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = SHIPPED.read_bytes()
    hub.make(*MODEL, private=False, files={"a.onnx": network, "old/b.onnx": network, "weights.pt": b"pickle"})
    said = failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")
    assert "has 2 networks; its networks are a.onnx, old/b.onnx (--file NAME)" in said
    assert "has no network weights.pt" in failed(
        capsys, "download", MODEL[1], "--file", "weights.pt", "--out", tmp_path / "got"
    )
    assert hub_main("download", MODEL[1], "--file", "old/b.onnx", "--out", tmp_path / "got") == 0
    assert [file.name for file in (tmp_path / "got").iterdir()] == ["b.onnx"]
    said = failed(capsys, "download", MODEL[1], "--file", "old/b.onnx", "--out", tmp_path / "got")
    assert f"{tmp_path / 'got/b.onnx'} exists and is not replaced" in said


def test_a_dataset_comes_back_as_the_same_version(
    hub: FakeHub, store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    version = open_dataset([store]).version
    assert hub_main("upload", DATASET[1], store.folder) == 0
    assert hub.repos[DATASET].private
    got = tmp_path / "got"
    download = ("download", DATASET[1], "--type", "dataset", "--expect", version.name, "--out", got)
    assert hub_main(*download) == 0
    assert f"dataset {version.name}, all digests are right" in capsys.readouterr().out
    assert (got.stat().st_mode & 0o077) == 0
    listed = read_version(got / f"frozen/{version.name}.json")
    mine, theirs = open_dataset([store]), open_dataset([Store(got)], only=listed)
    assert theirs.version.name == version.name == open_dataset([Store(got)]).version.name
    # In the same order, and the shards of a run still share an odometry frame: a training learns the same.
    assert theirs.frames.run[:].tolist() == mine.frames.run[:].tolist()
    assert [part.digest for part in theirs.parts] == [part.digest for part in mine.parts]
    # An interrupted download goes on, and one into another directory with files is refused.
    assert hub_main(*download) == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").touch()
    assert "is not empty" in failed(capsys, *download[:-1], tmp_path / "mine")


def test_another_dataset_than_expected_is_refused(
    hub: FakeHub, store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    version = open_dataset([store]).version
    got = ("--type", "dataset", "--expect", "0123456789abcdef", "--out", tmp_path / "got")
    said = failed(capsys, "download", DATASET[1], *got)
    assert f"holds dataset {version.name}, expected 0123456789abcdef; do not use it" in said
    assert not (tmp_path / "got").exists()
    # The name of the list alone is not believed.
    repo = hub.repos[DATASET]
    files = dict(repo.commits[repo.at("main") or ""])
    files["frozen/0123456789abcdef.json"] = files.pop(f"frozen/{version.name}.json")
    repo.add(files)
    said = failed(capsys, "download", DATASET[1], *got)
    assert f"0123456789abcdef.json lists dataset {version.name}; do not use it" in said


def test_a_list_that_was_changed_is_refused(
    hub: FakeHub, store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    version = open_dataset([store]).version
    repo = hub.repos[DATASET]
    files = dict(repo.commits[repo.at("main") or ""])
    listed = f"frozen/{version.name}.json"
    plain = json.loads(files[listed])
    del plain["shards"][0]
    repo.add({**files, listed: json.dumps(plain).encode()})
    said = failed(capsys, "download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got")
    assert f"{listed} was changed" in said


def test_nothing_that_is_uploaded_names_the_folders_of_the_user(hub: FakeHub, store: Store, tmp_path: Path) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    (commit,) = list(hub.repos[DATASET].commits)[-1:]
    for name, content in hub.repos[DATASET].commits[commit].items():
        assert b"anna" not in content, name
        assert "monday" not in name
        assert str(tmp_path).encode() not in content, name


def test_the_upload_in_several_commits_that_the_library_prefers_gives_the_same_dataset(
    hub: FakeHub, store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("hf_xet")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", False)
    # Large files would go to another server by another protocol.
    hub.has_large_files = False
    assert hub_main("upload", DATASET[1], store.folder) == 0
    assert hub_main("download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got") == 0
    assert open_dataset([Store(tmp_path / "got")]).version.name == open_dataset([store]).version.name


def test_a_frozen_list_is_uploaded_without_the_other_shards(hub: FakeHub, store: Store, tmp_path: Path) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    shards = [segment.shard for segment in segments_of(store)]
    version = freeze(store, shards[:2])
    write_version(version, tmp_path / "two.json")
    assert hub_main("upload", DATASET[1], tmp_path / "two.json", "--store", store.folder) == 0
    assert hub_main("download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got") == 0
    got = Store(tmp_path / "got")
    assert sorted(folder.name for folder in (got.folder / "shards").iterdir()) == sorted(shards[:2])
    assert open_dataset([got]).version.name == version.name


def test_labels_are_those_of_the_list_and_not_the_newest(hub: FakeHub, tmp_path: Path, robot: Path) -> None:
    walk = room(60)
    record(tmp_path / "runs/a", walk, [24, 36], range(1))
    first = store_of(tmp_path / "runs", tmp_path / "store", robot)
    version = open_dataset([first]).version
    write_version(version, tmp_path / "first.json")
    record(tmp_path / "runs/a", walk, [24, 36], range(1, 2))
    grown = store_of(tmp_path / "runs", tmp_path / "store", robot)
    assert hub_main("upload", DATASET[1], tmp_path / "first.json", "--store", grown.folder) == 0
    assert hub_main("download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got") == 0
    assert open_dataset([Store(tmp_path / "got")]).version.name == version.name


@pytest.mark.parametrize("name", ["rgb.npy", "meta.json"])
def test_a_shard_that_was_changed_is_named_and_refused(
    hub: FakeHub, store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    repo = hub.repos[DATASET]
    files = dict(repo.commits[repo.at("main") or ""])
    path = next(path for path in files if path.endswith(name))
    # The owner of the repository changes it: the digests of the hub are right.
    files[path] = files[path].replace(b"robot", b"other") if name == "meta.json" else files[path][:-1] + b"?"
    files[path] += b" " if name == "meta.json" else b""
    repo.add(files)
    said = failed(capsys, "download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got")
    assert path in said
    assert "has the digest" in said


@pytest.mark.parametrize("path", ["shards/../../outside.npy", "shards/a/weights.pkl", "runs/.hidden.json"])
def test_files_that_no_store_has_are_not_downloaded(
    hub: FakeHub, store: Store, tmp_path: Path, capsys: pytest.CaptureFixture[str], path: str
) -> None:
    assert hub_main("upload", DATASET[1], store.folder) == 0
    repo = hub.repos[DATASET]
    repo.add({**repo.commits[repo.at("main") or ""], path: b"x"})
    said = failed(capsys, "download", DATASET[1], "--type", "dataset", "--out", tmp_path / "got/store")
    assert f"is no store of shards: it holds {path}" in said
    assert not (tmp_path / "got").exists()


def test_images_of_a_home_are_public_only_when_the_user_says_so(
    hub: FakeHub, store: Store, capsys: pytest.CaptureFixture[str]
) -> None:
    hub.make(*DATASET, private=False)
    said = failed(capsys, "upload", DATASET[1], store.folder)
    assert "the dataset repository workshop/kitchen is public already and nothing was uploaded; give --public" in said
    assert len(hub.repos[DATASET].commits) == 1
    assert hub_main("upload", DATASET[1], store.folder, "--public") == 0
    assert "warning: the dataset repository workshop/kitchen is public, and images may show" in capsys.readouterr().err
    assert len(hub.repos[DATASET].commits) == 2
    # A private one stays private.
    hub.make("dataset", "workshop/secret", private=True)
    assert hub_main("upload", "workshop/secret", store.folder, "--public") == 0
    assert capsys.readouterr().out.endswith(", private\n")


def test_a_damaged_shard_is_not_uploaded(hub: FakeHub, store: Store, capsys: pytest.CaptureFixture[str]) -> None:
    array = next((store.folder / "shards").glob("*/rgb.npy"))
    array.write_bytes(array.read_bytes()[:-1] + b"?")
    assert f"{array} has the digest" in failed(capsys, "upload", DATASET[1], store.folder)
    assert DATASET not in hub.repos


def test_errors_of_the_hub_say_what_to_do(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    got = ("--out", tmp_path / "got")
    hub.make(*MODEL, private=True, files={"net.onnx": SHIPPED.read_bytes()})
    said = failed(capsys, "download", "workshop/nothing", *got)
    assert "cannot read the model repository workshop/nothing at main: 404" in said
    assert "check its name and --type" in said
    assert "give another --revision" in failed(capsys, "download", MODEL[1], "--revision", "v9", *got)
    assert "a repository is named OWNER/NAME" in failed(capsys, "download", "work shop/x y", *got)
    hub.refuses_private = True
    said = failed(capsys, "upload", "workshop/new", SHIPPED)
    assert "403" in said
    assert "a plan may limit private ones; --public publishes" in said
    assert ("model", "workshop/new") not in hub.repos
    monkeypatch.setenv("HF_TOKEN", "hf_old")
    assert "the token is not accepted" in failed(capsys, "download", MODEL[1], *got)
    monkeypatch.delenv("HF_TOKEN")
    said = failed(capsys, "upload", MODEL[1], SHIPPED)
    assert "there is no token to write to the model repository workshop/student; set HF_TOKEN" in said
    # Without a token a private repository is as one that does not exist.
    assert "a private repository needs a token" in failed(capsys, "download", MODEL[1], *got)


def test_a_hub_that_does_not_answer_is_an_error_of_the_user(
    hub: FakeHub, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
    said = failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")
    assert "check the connection and HF_ENDPOINT" in said


def test_without_the_library_the_command_says_how_to_get_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    said = failed(capsys, "download", MODEL[1], "--out", tmp_path / "got")
    assert "run `pip install huggingface_hub`" in said


def test_a_card_that_the_user_has_edited_is_uploaded_as_it_is(hub: FakeHub, tmp_path: Path) -> None:
    (tmp_path / "edited.md").write_text("---\nlicense: mit\n---\nmine\n")
    assert hub_main("upload", MODEL[1], SHIPPED, "--card", tmp_path / "edited.md") == 0
    repo = hub.repos[MODEL]
    assert repo.commits[repo.at("main") or ""]["README.md"] == (tmp_path / "edited.md").read_bytes()
