"""Joins a Ray cluster: processes on one or several computers that share the directories of the command."""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from embodied_depth_trainer.errors import TrainerError

LOCAL = "local"
FOUND = "ray"
BY_CLIENT = "ray://"


def place(text: str) -> str:
    """Where a command runs, as `--on` says it."""
    if text in (LOCAL, FOUND) or text.startswith(BY_CLIENT):
        return text
    raise argparse.ArgumentTypeError(f"`{text}` is neither `local`, `ray` nor `ray://HEAD:PORT`; give one of these")


@contextmanager
def joined(on: str) -> Iterator[Any]:
    """The module `ray`, connected to the cluster while the context lasts. A cluster that this process has joined
    already is used and kept."""
    ray = _ray()
    was_joined = ray.is_initialized()
    if not was_joined:
        _join(ray, on)
    try:
        print(f"Ray cluster: {_size(ray)}", file=sys.stderr)
        yield ray
    finally:
        if not was_joined:
            ray.shutdown()


def quiet(ray: Any) -> dict[str, Any]:  # noqa: ANN401
    """Options of `ray.init`: only errors in the logs of this process and of all others. Ray Train would warn every
    second that there is no dashboard, and tell each step of its work."""
    return {"logging_level": logging.ERROR, "logging_config": ray.LoggingConfig(log_level="ERROR")}


def result_of(ray: Any, task: Any) -> Any:  # noqa: ANN401
    """What a finished task returned. Its error is raised as it was there, without Ray's account of both processes."""
    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError as problem:
        if isinstance(problem.cause, TrainerError):
            raise problem.cause from None
        raise
    except ray.exceptions.RayError as problem:
        raise TrainerError(
            f"a process of the Ray cluster was lost again and again ({_first_line(problem)}), perhaps for lack of "
            "memory; what is done is kept: run the same command again"
        ) from None


def _size(ray: Any) -> str:  # noqa: ANN401
    found = ray.cluster_resources()
    nodes = sum(node["Alive"] for node in ray.nodes())
    return f"{nodes} nodes, {found.get('CPU', 0):g} CPUs, {found.get('GPU', 0):g} GPUs"


def _ray() -> Any:  # noqa: ANN401
    try:
        import ray
    except ImportError:
        raise TrainerError("--on ray needs Ray; run `pip install -e 'tools/trainer[ray]'` in the checkout") from None
    return ray


def _join(ray: Any, on: str) -> None:  # noqa: ANN401
    # A cluster that this starts would report to Ray's makers what it is used for.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    address = on if on.startswith(BY_CLIENT) else None
    try:
        # Without an address: RAY_ADDRESS, else the cluster that runs on this computer, else a new one.
        ray.init(address, **quiet(ray), **({} if address else {"include_dashboard": False}))
    except (ConnectionError, ValueError, RuntimeError, ImportError) as problem:
        name = address or os.environ.get("RAY_ADDRESS") or "this computer"
        raise TrainerError(
            f"cannot join the Ray cluster of {name}: {_first_line(problem)}; start it with `ray start --head`, "
            "and give the address that this prints"
        ) from None


def _first_line(problem: BaseException) -> str:
    return str(problem).strip().partition("\n")[0]
