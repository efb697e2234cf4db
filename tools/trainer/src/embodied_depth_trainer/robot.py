"""The robot's program, `firmware-host`, as the loop drives it."""

from __future__ import annotations

import ctypes
import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from .errors import TrainerError
from .schedule import Schedule

# Between two looks for what the robot writes.
LOOK_EVERY_S = 0.1
LOG_LINES = 8
# Frames of the paper's 30,000 on frontiers before `active` turns to inconsistencies for half as long (section III-D). A
# short run would never come to the inconsistencies without fewer; at least what a goal takes to be reached.
FRONTIER, LEAST_FRONTIER = 800 / 30_000, 80


def find_firmware_host(given: Path | None) -> Path:
    """The given program, or the one on the PATH, or the workspace's own."""
    if given is not None:
        if not given.is_file():
            raise TrainerError(f"{given} is no program; build it with `cargo build --release -p firmware-host`")
        return given.resolve()
    found = shutil.which("firmware-host")
    own = [folder / "target/release/firmware-host" for folder in Path(__file__).resolve().parents]
    for path in [Path(found)] if found else own:
        if path.is_file():
            return path
    raise TrainerError(
        "firmware-host was not found; build it with `cargo build --release -p firmware-host`, "
        "or give --firmware-host FILE"
    )


def robot_config(size: tuple[int, int], step_scale: float, warm_up: int, frames: int) -> str:
    """What differs from the robot's defaults, as TOML: pictures of `size`, the paper's steps times `step_scale`, and
    its phases in a run of so many frames."""
    height, width = size
    frontier = max(LEAST_FRONTIER, round(FRONTIER * frames))
    return (
        f"[camera]\nwidth = {width}\nheight = {height}\n\n"
        f"[base]\nforward_step_m = {0.03 * step_scale:.6g}\nturn_step_deg = {2.0 * step_scale:.6g}\n\n"
        f"[exploration]\nwarm_up_frames = {warm_up}\n"
        f"frontier_frames = {frontier}\ninconsistency_frames = {frontier // 2}\n"
    )


def die_with_parent() -> None:
    """A robot must not wait for a trainer that was killed. Runs in the child; Linux only."""
    if sys.platform == "linux":
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


def last_lines(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-LOG_LINES:])


def render_views(program: Path, scene: str, config: Path, count: int, seed: int, out: Path, log: Path) -> None:
    """Test views of a scene into `out`, which is there whole or not at all."""
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    command = [str(program), "views", "--scene", scene, "--count", str(count), "--seed", str(seed)]
    with log.open("ab") as stream:
        done = subprocess.run(
            [*command, "--config", str(config), "--out", str(partial)], stdout=stream, stderr=stream, check=False
        )
    if done.returncode != 0:
        raise TrainerError(f"firmware-host could not render test views; {log} ends with\n{last_lines(log)}")
    partial.rename(out)


def explore(program: Path, scene: str, policy: str, seed: int, frames: int, config: Path, out: Path, log: Path) -> None:
    """A run on coarse depth, with that in `out`/coarse. `out` is there whole or not at all."""
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    command = [str(program), "explore", "--scene", scene, "--policy", policy, "--seed", str(seed)]
    command += ["--frames", str(frames), "--config", str(config)]
    command += ["--out", str(partial), "--dump", str(partial / "coarse")]
    with log.open("ab") as stream:
        done = subprocess.run(command, stdout=stream, stderr=stream, check=False, preexec_fn=die_with_parent)
    if done.returncode != 0:
        raise TrainerError(f"firmware-host did not explore {scene}; {log} ends with\n{last_lines(log)}")
    partial.rename(out)


@dataclass(frozen=True)
class Mission:
    """What the robot is sent to do."""

    program: Path
    scene: str
    policy: str
    seed: int
    config: Path
    schedule: Schedule
    dump: bool
    """Whether coarse depth is kept for training."""


class Exploration:
    """One run of the robot, from its start: deterministic, so that one that was killed is begun anew and takes the
    models that it had been handed before. Within `folder`: `run/` is what it writes, `hand-over/` how models come."""

    def __init__(self, folder: Path, mission: Mission) -> None:
        self.run, self.dump, self.hand_over = folder / "run", folder / "run" / "coarse", folder / "hand-over"
        self.log = folder / "firmware-host.log"
        self.mission = mission
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Exploration:
        if not self.is_over():
            self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def is_over(self) -> bool:
        """Whether the whole run is there."""
        summary = self.run / "summary.json"
        return summary.exists() and json.loads(summary.read_text())["end_reason"] == "frame_budget"

    def _start(self) -> None:
        shutil.rmtree(self.run, ignore_errors=True)
        self.hand_over.mkdir(parents=True, exist_ok=True)
        for said in self.hand_over.glob("round_*.json"):
            said.replace(said.with_suffix(".before"))
        m = self.mission
        command = [str(m.program), "explore", "--scene", m.scene, "--policy", m.policy, "--seed", str(m.seed)]
        command += ["--frames", str(m.schedule.frames), "--config", str(m.config), "--out", str(self.run)]
        command += ["--hand-over", str(self.hand_over), "--first", str(m.schedule.warm_up)]
        command += ["--every", str(m.schedule.every)]
        if m.dump:
            command += ["--dump", str(self.dump)]
        with self.log.open("ab") as stream:
            self.process = subprocess.Popen(command, stdout=stream, stderr=stream, preexec_fn=die_with_parent)

    def wait_for_round(self, index: int) -> int:
        """Until the robot waits for its next model; how many segments of the recording are whole then."""
        file = self.hand_over / f"round_{index:04d}.json"
        while not file.exists():
            self._check_alive(f"before training {index}")
        said: dict[str, Any] = json.loads(file.read_text())
        before = file.with_suffix(".before")
        if before.exists() and json.loads(before.read_text()) != said:
            raise TrainerError(
                f"the robot does not repeat the run that was cut off: {file} and {before} differ; "
                "go on with the same firmware-host, or give another --out"
            )
        return int(said["segments"])

    def wait_for_end(self) -> None:
        while not self.is_over():
            self._check_alive("before its frames were done")

    def _check_alive(self, when: str) -> None:
        if self.process is None or (self.process.poll() is not None and not self.is_over()):
            code = None if self.process is None else self.process.returncode
            raise TrainerError(f"firmware-host ended {when} with {code}; {self.log} ends with\n{last_lines(self.log)}")
        time.sleep(LOOK_EVERY_S)

    def model(self, index: int) -> Path:
        """Where the robot looks for the network of training `index`."""
        return self.hand_over / f"model_{index:04d}.onnx"

    def summary(self) -> dict[str, Any]:
        """What the whole run came to."""
        found: dict[str, Any] = json.loads((self.run / "summary.json").read_text())
        return found
