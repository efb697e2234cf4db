"""Runs all loops of a job file as tasks of a Ray cluster: `python ray_jobs.py jobs.txt`.

All nodes must share the directories in the file. A task whose node fails is started elsewhere and continues.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import ray

from embodied_depth_trainer.studies.jobs import read_jobs


@ray.remote(num_cpus=2, max_retries=3)  # type: ignore[misc]
def run(file: str, number: int) -> int:
    """Runs one loop; returns its exit status."""
    return subprocess.run(["embodied-depth", "loop", "--jobs", file, "--job", str(number)], check=False).returncode


def main(file: str) -> int:
    count = len(read_jobs(Path(file)))
    ray.init()
    tasks = [run.remote(str(Path(file).resolve()), number) for number in range(1, count + 1)]
    failed = [number for number, status in enumerate(ray.get(tasks), 1) if status != 0]
    print(f"{count - len(failed)} of {count} loops are done", f"failed: {failed}" if failed else "")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
