"""Runs the robot's program, `firmware-host`, for studies."""

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

from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.studies.schedule import Schedule

# Interval between two checks for files that the robot writes.
POLL_INTERVAL_S = 0.1
LOG_LINES = 8
# Share of the paper's 30,000 frames that `active` spends on frontiers before it explores inconsistencies for half as
# long (section III-D). A short run gets at least the number of frames that reaching a goal takes; otherwise it would
# never come to the inconsistencies.
FRONTIER_SHARE = 800 / 30_000
MIN_FRONTIER_FRAMES = 80


def find_firmware_host(given: Path | None) -> Path:
    """The given program, or the one on the PATH, or the workspace's own release build."""
    if given is not None:
        if not given.is_file():
            raise TrainerError(f"{given} is not a file; build it with `cargo build --release -p firmware-host`")
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
    """The robot's configuration as TOML, without defaults: images of `size`, the paper's steps times `step_scale`, and
    the phases of a run of this many frames."""
    height, width = size
    frontier = max(MIN_FRONTIER_FRAMES, round(FRONTIER_SHARE * frames))
    return (
        f"[camera]\nwidth = {width}\nheight = {height}\n\n"
        f"[base]\nforward_step_m = {0.03 * step_scale:.6g}\nturn_step_deg = {2.0 * step_scale:.6g}\n\n"
        f"[exploration]\nwarm_up_frames = {warm_up}\n"
        f"frontier_frames = {frontier}\ninconsistency_frames = {frontier // 2}\n"
    )


def die_with_parent() -> None:
    """Ends the robot when the trainer is killed, instead of waiting for it forever. Runs in the child; Linux only."""
    if sys.platform == "linux":
        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL)


def last_lines(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-LOG_LINES:])


def render_views(program: Path, scene: str, config: Path, count: int, seed: int, out: Path, log: Path) -> None:
    """Renders test views of a scene into `out`, which appears complete or not at all."""
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    command = [str(program), "views", "--scene", scene, "--count", str(count), "--seed", str(seed)]
    with log.open("ab") as stream:
        command += ["--config", str(config), "--out", str(partial)]
        done = subprocess.run(command, stdout=stream, stderr=stream, check=False, preexec_fn=die_with_parent)
    if done.returncode != 0:
        raise TrainerError(f"firmware-host could not render test views; {log} ends with\n{last_lines(log)}")
    partial.rename(out)


def explore(
    program: Path,
    scene: str,
    policy: str,
    seed: int,
    frames: int,
    config: Path,
    out: Path,
    log: Path,
    dump: bool = True,
) -> None:
    """Explores without a network. With `dump`, coarse depth is written to `out`/coarse. `out` appears complete or
    not at all."""
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    command = [str(program), "explore", "--scene", scene, "--policy", policy, "--seed", str(seed)]
    command += ["--frames", str(frames), "--config", str(config)]
    command += ["--out", str(partial)]
    if dump:
        command += ["--dump", str(partial / "coarse")]
    with log.open("ab") as stream:
        done = subprocess.run(command, stdout=stream, stderr=stream, check=False, preexec_fn=die_with_parent)
    if done.returncode != 0:
        raise TrainerError(f"firmware-host did not explore {scene}; {log} ends with\n{last_lines(log)}")
    partial.rename(out)


@dataclass(frozen=True)
class Mission:
    """The task of the robot."""

    program: Path
    scene: str
    policy: str
    seed: int
    config: Path
    schedule: Schedule
    dump: bool
    """Whether coarse depth is saved for training."""


class Exploration:
    """One run of the robot. It is deterministic: a run that was killed is repeated from its start with the models that
    it had received. Within `folder`, the robot writes `run/` and receives models through `hand-over/`."""

    def __init__(self, folder: Path, mission: Mission) -> None:
        self.run = folder / "run"
        self.dump = self.run / "coarse"
        self.hand_over = folder / "hand-over"
        self.log = folder / "firmware-host.log"
        self.mission = mission
        self.process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Exploration:
        if not self.is_complete():
            self._start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def is_complete(self) -> bool:
        """Whether the run has reached its last frame."""
        summary = self.run / "summary.json"
        return summary.exists() and json.loads(summary.read_text())["end_reason"] == "frame_budget"

    def _start(self) -> None:
        shutil.rmtree(self.run, ignore_errors=True)
        self.hand_over.mkdir(parents=True, exist_ok=True)
        for file in self.hand_over.glob("round_*.json"):
            file.replace(file.with_suffix(".before"))
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
        """Waits until the robot needs its next model; returns how many segments of the recording are complete then."""
        file = self.hand_over / f"round_{index:04d}.json"
        while not file.exists():
            self._check_alive(f"before training {index}")
        request: dict[str, Any] = json.loads(file.read_text())
        before = file.with_suffix(".before")
        if before.exists() and json.loads(before.read_text()) != request:
            raise TrainerError(
                f"the robot does not repeat the interrupted run: {file} and {before} differ; "
                "continue with the same firmware-host, or give another --out"
            )
        return int(request["segments"])

    def wait_for_end(self) -> None:
        while not self.is_complete():
            self._check_alive("before its last frame")

    def _check_alive(self, when: str) -> None:
        if self.process is None or (self.process.poll() is not None and not self.is_complete()):
            code = None if self.process is None else self.process.returncode
            raise TrainerError(f"firmware-host ended {when} with {code}; {self.log} ends with\n{last_lines(self.log)}")
        time.sleep(POLL_INTERVAL_S)

    def model(self, index: int) -> Path:
        """The file from which the robot loads the network of training `index`."""
        return self.hand_over / f"model_{index:04d}.onnx"

    def summary(self) -> dict[str, Any]:
        """The summary that the robot wrote at the end of its run."""
        found: dict[str, Any] = json.loads((self.run / "summary.json").read_text())
        return found
