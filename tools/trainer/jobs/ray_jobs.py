"""All loops of a job file as tasks of a Ray cluster: `python ray_jobs.py jobs.txt`.

Folders in the file must be seen by every node. A task whose node dies is begun again elsewhere, and goes on where it was.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import ray


@ray.remote(num_cpus=2, max_retries=3)  # type: ignore[misc]
def run(file: str, number: int) -> int:
    """The exit status of one loop."""
    return subprocess.run(["embodied-depth", "loop", "--jobs", file, "--job", str(number)], check=False).returncode


def main(file: str) -> int:
    lines = [line.split("#")[0].strip() for line in Path(file).read_text().splitlines()]
    count = len([line for line in lines if line])
    ray.init()
    tasks = [run.remote(str(Path(file).resolve()), number) for number in range(1, count + 1)]
    failed = [number for number, status in enumerate(ray.get(tasks), 1) if status != 0]
    print(f"{count - len(failed)} of {count} loops are done", f"failed: {failed}" if failed else "")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
