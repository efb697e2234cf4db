"""Measures catalogue and planning on the metadata of a fleet's year: 100 robots, 100 hours each.

    python -m benchmarks.year WORK [ROBOTS RUNS SEGMENTS]      (in tools/trainer)

Makes the year in WORK unless it is there, and prints a table. Each row is measured by a process of its own, medians of
three. Seconds are of the clock and of the processor, because other programs run as well; memory is the most that was
resident, above that of Python and its packages.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import duckdb  # noqa: F401

from embodied_depth_trainer.data.past_frames import PastFrames
from embodied_depth_trainer.store.catalogue import CATALOGUE_FILE, query, update
from embodied_depth_trainer.store.complete import COMPLETE_FILE
from embodied_depth_trainer.store.listing import freeze
from embodied_depth_trainer.store.prepare import Tools, plan, prepare
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store
from embodied_depth_trainer.store.version import write_version
from tests.rooms import room
from tests.stores import record
from tests.year import Year, make_year

RECIPE = Recipe("past frames", past=PastFrames(2, 4))
# Frames of the real segments, which the metadata refers to.
REAL = [70, 70, 70]
RUNS = 3
STOPS = """SELECT site, sum(events['safety']) AS stops FROM segments
    WHERE scene LIKE '%stairs=1%' AND began > (SELECT max(began) FROM segments) - INTERVAL 7 DAY
    GROUP BY site ORDER BY stops DESC"""
DRIVEN = "SELECT name, sum(frames), sum(length_m) FROM segments GROUP BY name ORDER BY name"
LOST = "SELECT month(began) AS month, count(*) FROM segments WHERE events['lost'] > 0 GROUP BY month ORDER BY month"
LAST_WEEK = "SELECT shard FROM segments WHERE began > (SELECT max(began) FROM segments) - INTERVAL 7 DAY"
ALL = "SELECT shard FROM segments"


def build(work: Path) -> int:
    (work / "store" / CATALOGUE_FILE).unlink(missing_ok=True)
    update(work / "store")
    return int(query(work / "store", "SELECT count(*) FROM segments").rows[0][0])


def refresh(work: Path) -> int:
    """One run of one robot has new segments."""
    os.utime(next((work / "store" / "runs").glob("*.json")))
    update(work / "store")
    return 1


def asked(sql: str) -> Callable[[Path], int]:
    return lambda work: len(query(work / "store", sql).rows)


def frozen(sql: str) -> Callable[[Path], int]:
    def part(work: Path) -> int:
        version = freeze(Store(work / "store"), [row[0] for row in query(work / "store", sql).rows])
        write_version(version, work / "frozen.json")
        return len(version.shards)

    return part


def known_first(work: Path) -> int:
    """All segments have shards and labels, and no plan has found that before."""
    (work / "store" / COMPLETE_FILE).unlink(missing_ok=True)
    return known(work)


def known(work: Path) -> int:
    """All segments have shards and labels."""
    store = Store(work / "store")
    shards, labels = plan([work / "pulled"], store, Tools(RECIPE))
    return shards.total + labels.total


def missing(work: Path) -> int:
    """No segment has a shard."""
    shutil.rmtree(work / "empty", ignore_errors=True)
    return plan([work / "pulled"], Store.create(work / "empty", RECIPE), Tools(RECIPE))[0].total


PARTS: dict[str, Callable[[Path], int]] = {
    "catalogue: the first table": build,
    "catalogue: one run has grown": refresh,
    "query: stops in the last week in homes with stairs": asked(STOPS),
    "query: frames and metres of each robot": asked(DRIVEN),
    "query: segments in which a robot was lost, by month": asked(LOST),
    "freeze: the last week": frozen(LAST_WEEK),
    "freeze: the year": frozen(ALL),
    "`prepare` planning: nothing is missing (shards and labels), for the first time": known_first,
    "`prepare` planning: nothing is missing, again": known,
    "`prepare` planning: all shards are missing": missing,
}


def memory_mib(field: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith(f"{field}:"))
    return float(line.split()[1]) / 1024


def measure(name: str, work: Path) -> dict[str, float]:
    """What one part takes in this process."""
    # Makes the kernel measure the most memory from now on.
    Path("/proc/self/clear_refs").write_text("5")
    program, clock, processor = memory_mib("VmRSS"), time.perf_counter(), time.process_time()
    found = PARTS[name](work)
    return {
        "found": found,
        "clock_s": time.perf_counter() - clock,
        "processor_s": time.process_time() - processor,
        "memory_mib": memory_mib("VmHWM") - program,
    }


def measured(name: str, work: Path) -> dict[str, float]:
    """What one part takes in new processes."""
    command = [sys.executable, "-m", "benchmarks.year", str(work), name]
    printed = [subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout for _ in range(RUNS)]
    runs = [json.loads(text) for text in printed]
    return {key: statistics.median(run[key] for run in runs) for key in runs[0]}


def make(year: Year, work: Path) -> None:
    real = work / "real"
    record(real / "run", room(sum(REAL)), REAL)
    store = Store.create(real / "store", RECIPE)
    prepare([real / "run"], store, Tools(RECIPE))
    make_year(year, store, sorted((real / "run").glob("*.mcap")), work)


def main() -> None:
    work, *rest = sys.argv[1:]
    if rest and rest[0] in PARTS:
        print(json.dumps(measure(rest[0], Path(work))))
        return
    if not Path(work, "store").exists():
        make(Year(*map(int, rest)), Path(work))
    print("| what | found | seconds of the clock | seconds of the processor | memory, MiB |")
    print("|---|---|---|---|---|")
    for name in PARTS:
        row = measured(name, Path(work))
        numbers = f"{row['clock_s']:.3g} | {row['processor_s']:.3g} | {row['memory_mib']:.0f}"
        print(f"| {name} | {row['found']:,.0f} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
