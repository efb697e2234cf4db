"""Data-parallel training by the processes of a Ray cluster: Ray starts them where CPUs or GPUs are free and joins them
(`processes.py` says what they share), and starts all of them again when one is lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from embodied_depth_trainer.cluster import joined, result_of
from embodied_depth_trainer.errors import TrainerError
from embodied_depth_trainer.shared_folder import check_mark, marked

# How often all processes are started again.
RESTARTS = 3
Options = TypeVar("Options")


@dataclass(frozen=True)
class Ranks:
    """The processes of a training."""

    count: int
    on: str
    """The cluster; see `cluster.place`."""
    threads: int
    """CPUs of each."""
    device: str
    """`auto`, `cpu` or `cuda`; `auto` is one GPU each if the cluster has enough of them."""
    out: Path
    """The directory of the checkpoint, which all nodes share."""


def run_ranks(work: Callable[[Options, str], None], options: Options, ranks: Ranks) -> None:
    """Calls `work` with the options and a device in every process. It must go on from what is in `out`."""
    if ranks.count < 1:
        raise TrainerError(f"{ranks.count} ranks do nothing; give 1 or more with --ranks")
    with joined(ranks.on) as ray, marked(ranks.out) as mark:
        device = _device(ranks, ray.cluster_resources().get("GPU", 0))
        # In a task, because Ray Train needs a process of the cluster, which one that has joined by ray:// is not.
        fit = ray.remote(num_cpus=0, max_retries=RESTARTS)(_fit)
        result_of(ray, fit.remote(work, options, ranks, device, mark))


def _device(ranks: Ranks, gpus: float) -> str:
    if ranks.device == "cuda" and gpus < ranks.count:
        raise TrainerError(
            f"the Ray cluster has {gpus:g} GPUs for {ranks.count} ranks (--device cuda); give fewer --ranks, or "
            "--device cpu"
        )
    return "cuda" if ranks.device == "cuda" or (ranks.device == "auto" and gpus >= ranks.count) else "cpu"


def _fit(work: Callable[[Options, str], None], options: Options, ranks: Ranks, device: str, mark: Path) -> None:
    """Runs in a process of the cluster, until all ranks are done."""
    from ray.train import FailureConfig, RunConfig, ScalingConfig, TrainingFailedError
    from ray.train.torch import TorchTrainer

    check_mark(mark)
    trainer = TorchTrainer(
        _rank,
        train_loop_config={"work": work, "options": options, "device": device, "mark": mark},
        scaling_config=ScalingConfig(
            num_workers=ranks.count, use_gpu=device == "cuda", resources_per_worker={"CPU": ranks.threads}
        ),
        run_config=RunConfig(
            name="ranks",
            storage_path=str(mark),
            failure_config=FailureConfig(max_failures=RESTARTS),
            callbacks=[_stop_at_errors()],
        ),
    )
    try:
        trainer.fit()
    except TrainingFailedError as problem:
        raise _explained(problem) from None


def _rank(config: dict[str, Any]) -> None:
    """One rank; Ray has connected it to the others."""
    check_mark(config["mark"])
    config["work"](config["options"], config["device"])


def _stop_at_errors() -> Any:  # noqa: ANN401
    """Ray starts ranks again after any error. What the user must correct would only be found again."""
    from ray.train import UserCallback

    class StopAtErrors(UserCallback):
        def after_exception(self, run_context: Any, worker_exceptions: dict[int, Exception]) -> None:  # noqa: ANN401
            for problem in worker_exceptions.values():
                if (found := _user_error(problem)) is not None:
                    raise found

    return StopAtErrors()


def _explained(problem: Exception) -> TrainerError:
    causes = [getattr(problem, "controller_failure", None), *getattr(problem, "worker_failures", {}).values()]
    for cause in causes:
        if (found := _user_error(cause)) is not None:
            return found
    return TrainerError(
        f"the training failed {1 + RESTARTS} times on the Ray cluster: {problem}; the checkpoint in --out is kept: run "
        "the same command again"
    )


def _user_error(problem: object) -> TrainerError | None:
    """The error of this package in an error of Ray, which wraps it once or more."""
    while problem is not None and not isinstance(problem, TrainerError):
        inner = ("_base_exc", "controller_failure", "cause", "__cause__")
        problem = next((found for name in inner if (found := getattr(problem, name, None)) is not None), None)
    return problem
