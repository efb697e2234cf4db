"""Measures catalogue and planning on the metadata of a fleet's year: 100 robots, 100 hours each.

    python -m benchmarks.year WORK [ROBOTS RUNS SEGMENTS]      (in tools/trainer)

Makes the year in WORK unless it is there, and prints a table. Each row is measured by a process of its own. Seconds are
of the clock and of the processor, because other programs run as well; memory is the most that was resident, above that
of Python and its packages.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from embodied_depth_trainer.store import catalogue, listing
from embodied_depth_trainer.store.recipe import Recipe
from embodied_depth_trainer.store.store import Store
from tests.rooms import room
from tests.stores import record
from tests.year import Year, make_year

# Sizes of the segments in frames; what is read of them does not depend on it.
REAL = [70, 70, 70]
