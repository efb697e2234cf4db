"""The files in `jobs/`, which run the trainer on clusters: what can be checked of them without a cluster."""

from __future__ import annotations

import ast
import itertools
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from embodied_depth_trainer.commands.cli import main, parser

from .rooms import room
from .stores import calls, record

yaml = pytest.importorskip("yaml")

TRAINER = Path(__file__).resolve().parents[1]
JOBS = TRAINER / "jobs"
FILES = sorted(file.name for file in JOBS.iterdir() if file.is_file())
EXAMPLES = [name for name in FILES if name.endswith(".yaml")]
PROGRAM = "embodied-depth"
OPERATORS = {"&&", "||", "|", ";", "&", ">", "<", ">>"}
# What variables of the scripts stand for, so that their command lines can be read.
VALUES = {
    "@": "pulled --out store",
    "1": "jobs.txt",
    "SLURM_ARRAY_TASK_ID": "2",
    "parts": "4",
    "workers": "4",
    "ranks": "2",
    "RECORDINGS": "s3://fleet/kitchen",
}


def documents(name: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((JOBS / name).read_text()))


def scripts(name: str) -> list[str]:
    """The shell scripts in a file."""
    if name.endswith(".sh"):
        return [(JOBS / name).read_text()]
    if name.endswith(".yaml"):
        return list(itertools.chain.from_iterable(map(scripts_in, documents(name))))
    return []


def scripts_in(document: dict[str, Any]) -> Iterator[str]:
    """The scripts of a SkyPilot task, a config map or a RayJob."""
    yield from (document[key] for key in ("setup", "run") if key in document)
    yield from document.get("data", {}).values()
    if "entrypoint" in document.get("spec", {}):
        yield document["spec"]["entrypoint"]


def command_lines(name: str) -> list[list[str]]:
    """The arguments of every call of `embodied-depth` in a file."""
    if name.endswith(".py"):
        return list(calls_in_python((JOBS / name).read_text()))
    return list(itertools.chain.from_iterable(map(calls_in_shell, scripts(name))))


def calls_in_shell(script: str) -> Iterator[list[str]]:
    for line in script.replace("\\\n", " ").splitlines():
        if PROGRAM not in shlex.split(line, comments=True):
            continue
        words = shlex.shlex(filled(line), posix=True, punctuation_chars=True)
        words.whitespace_split = True
        called = itertools.dropwhile(lambda word: word != PROGRAM, words)
        next(called)
        yield list(itertools.takewhile(lambda word: word not in OPERATORS, called))


def filled(line: str) -> str:
    """The line with values for its variables."""
    line = line.replace('"$@"', VALUES["@"])
    return re.sub(r"\$\{?(\w+)\}?", lambda found: VALUES[found[1]], line)


def calls_in_python(source: str) -> Iterator[list[str]]:
    """Lists that begin with the program's name; what is computed in them stands for a number."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.List) and node.elts and getattr(node.elts[0], "value", None) == PROGRAM:
            yield [str(word.value) if isinstance(word, ast.Constant) else "1" for word in node.elts[1:]]


@pytest.mark.parametrize("name", FILES)
def test_the_trainer_understands_every_command_line(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = command_lines(name)
    assert found, f"no call of {PROGRAM} was found in {name}"
    for words in found:
        try:
            parser(words[0]).parse_args(words)
        except SystemExit:
            pytest.fail(f"{name}: `{shlex.join([PROGRAM, *words])}`: {capsys.readouterr().err}")


def test_a_renamed_option_would_be_found() -> None:
    (words,) = calls_in_shell('exec embodied-depth prepare "$@" --portion "$SLURM_ARRAY_TASK_ID/$parts" && echo done')
    assert words == ["prepare", "pulled", "--out", "store", "--portion", "2/4"]
    with pytest.raises(SystemExit):
        parser("prepare").parse_args(words)


@pytest.mark.parametrize("name", [name for name in FILES if scripts(name)])
def test_the_shell_can_read_every_script(name: str) -> None:
    for script in scripts(name):
        subprocess.run(["sh", "-n"], input=script.encode(), check=True)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_begins_by_saying_that_it_was_not_run(name: str) -> None:
    assert (JOBS / name).read_text().startswith("# Not run by this project: ")


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_prepares_and_then_trains_what_it_has_prepared(name: str) -> None:
    prepared, trained = (parser(words[0]).parse_args(words) for words in command_lines(name))
    assert (prepared.command, prepared.on) == ("prepare", "ray")
    assert (trained.command, trained.on) == ("train", "ray")
    assert trained.store == [prepared.out]
    # A checkpoint on the disk of one node would be lost with it.
    assert Path("/shared") in prepared.out.parents
    assert Path("/shared") in trained.out.parents


def test_the_task_of_skypilot_has_what_it_needs() -> None:
    (task,) = documents("sky_train.yaml")
    # A word that `sky.Task` does not know would be refused by it.
    assert task.keys() <= {"name", "workdir", "num_nodes", "resources", "volumes", "envs", "secrets", "setup", "run"}
    assert task["num_nodes"] > 1
    assert task["resources"].keys() >= {"infra", "cpus", "memory", "accelerators"}
    assert "/shared" in task["volumes"]
    assert all(isinstance(value, str) for value in task["envs"].values())
    # A secret that stands in the file is none.
    assert not any(task["secrets"].values())


@pytest.mark.parametrize(("node", "expected"), [(0, ["prepare", "train"]), (1, [])])
def test_the_first_node_of_skypilot_runs_the_commands(node: int, expected: list[str], tmp_path: Path) -> None:
    (task,) = documents("sky_train.yaml")
    for name in ("trainer/bin/activate", "sky_templates/ray/start_cluster"):
        written = program(tmp_path / name, "true")
    said = tmp_path / "said"
    program(tmp_path / f"bin/{PROGRAM}", f'echo "$RAY_ADDRESS $*" >> {said}')
    variables = {"NODE_RANK": node, "NUM_NODES": 2, "NUM_GPUS_PER_NODE": 3, "NODE_IPS": "10.0.0.7\n10.0.0.8"}
    environment = {**task["envs"], **{f"SKYPILOT_{name}": str(value) for name, value in variables.items()}}
    environment |= {"HOME": str(tmp_path), "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    assert written.exists()
    subprocess.run(["bash", "-c", task["run"]], env=environment, check=True)
    lines = said.read_text().splitlines() if said.exists() else []
    assert [line.split()[1] for line in lines] == expected
    assert all(line.startswith("10.0.0.7:6379 ") for line in lines)
    assert not lines or "--ranks 6" in lines[-1]


def program(file: Path, script: str) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/bin/sh\n{script}\n")
    file.chmod(0o755)
    return file


def test_the_job_of_kuberay_has_what_it_needs() -> None:
    commands, job = documents("kuberay.yaml")
    assert (job["apiVersion"], job["kind"]) == ("ray.io/v1", "RayJob")
    cluster = job["spec"]["rayClusterSpec"]
    head, workers = cluster["headGroupSpec"], cluster["workerGroupSpecs"]
    for group in workers:
        assert group.keys() >= {"groupName", "replicas", "minReplicas", "maxReplicas", "rayStartParams", "template"}
    for group in (head, *workers):
        # Ray's parameters are words of a command line.
        assert all(isinstance(value, str) for value in group["rayStartParams"].values())
        check_pod(group["template"]["spec"])
    images = {group["template"]["spec"]["containers"][0]["image"] for group in (head, *workers)}
    assert len(images) == 1
    (file,) = commands["data"]
    mounted = {volume["mountPath"] for volume in head["template"]["spec"]["containers"][0]["volumeMounts"]}
    assert job["spec"]["entrypoint"] == f"sh /commands/{file}"
    assert "/commands" in mounted


def check_pod(pod: dict[str, Any]) -> None:
    (container,) = pod["containers"]
    assert container.keys() >= {"name", "image", "resources", "volumeMounts"}
    # Ray believes the limits, and a pod may be given no more than its requests.
    assert container["resources"]["requests"] == container["resources"]["limits"]
    volumes = {volume["name"]: volume for volume in pod["volumes"]}
    mounts = {mount["mountPath"]: volumes[mount["name"]] for mount in container["volumeMounts"]}
    assert mounts["/shared"]["persistentVolumeClaim"] == {"claimName": "embodied-depth"}


def test_the_workers_of_kuberay_have_a_gpu_for_each_rank() -> None:
    trained = command_lines("kuberay.yaml")[-1]
    (group,) = documents("kuberay.yaml")[1]["spec"]["rayClusterSpec"]["workerGroupSpecs"]
    limits = group["template"]["spec"]["containers"][0]["resources"]["limits"]
    assert parser("train").parse_args(trained).ranks == group["replicas"] * int(limits["nvidia.com/gpu"])


@pytest.fixture
def task_of_an_array(tmp_path: Path) -> dict[str, str]:
    """The environment of a script of SLURM in which `embodied-depth` is this trainer."""
    program(tmp_path / f"bin/{PROGRAM}", f'exec {shlex.quote(sys.executable)} -m embodied_depth_trainer "$@"')
    path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "PYTHONPATH": str(TRAINER / "src"), "SLURM_CPUS_PER_TASK": "1"}


def test_an_array_of_slurm_and_the_job_after_it_make_the_store_of_one_process(
    tmp_path: Path, robot: Path, task_of_an_array: dict[str, str]
) -> None:
    record(tmp_path / "pulled/run", room(40), [14, 14, 12])
    arguments = [str(tmp_path / "pulled"), "--firmware-host", str(robot), "--out"]
    script = ["sh", str(JOBS / "slurm_prepare.sh"), *arguments, str(tmp_path / "store")]
    variables = [{"SLURM_ARRAY_TASK_ID": str(number), "SLURM_ARRAY_TASK_COUNT": "2"} for number in (1, 2)]
    tasks = [subprocess.Popen(script, env=task_of_an_array | task) for task in variables]
    assert [task.wait() for task in tasks] == [0, 0]
    assert calls(robot) == 3
    assert not (tmp_path / "store/runs").exists()
    subprocess.run(script, env=task_of_an_array, check=True)
    assert calls(robot) == 3
    assert main(["prepare", *arguments, str(tmp_path / "alone")]) == 0
    assert content(tmp_path / "store") == content(tmp_path / "alone")


def content(out: Path) -> dict[str, bytes]:
    return {str(file.relative_to(out)): file.read_bytes() for file in out.rglob("*") if file.is_file()}


def test_some_tasks_of_an_array_are_repeated_with_the_parts_of_all(tmp_path: Path) -> None:
    program(tmp_path / f"bin/{PROGRAM}", 'echo "$*"')
    environment = {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "PARTS": "16"}
    environment |= {"SLURM_ARRAY_TASK_ID": "7", "SLURM_ARRAY_TASK_COUNT": "2", "SLURM_CPUS_PER_TASK": "4"}
    script = ["sh", str(JOBS / "slurm_prepare.sh"), "pulled", "--out", "store"]
    done = subprocess.run(script, env=environment, check=True, capture_output=True, text=True)
    assert done.stdout == "prepare pulled --out store --workers 4 --part 7/16\n"
