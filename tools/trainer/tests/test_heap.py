"""What the heap does with memory that was freed."""

from __future__ import annotations

import subprocess
import sys

STEPS = """
import resource, torch
from embodied_depth_trainer.heap import keep_freed_memory
{call}
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    torch.ones(16 << 20)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
faults()
print(faults())
"""


def page_faults(call: str) -> int:
    """Of 64 MiB, allocated for the second time."""
    program = [sys.executable, "-c", STEPS.format(call=call)]
    return int(subprocess.run(program, check=True, capture_output=True, text=True).stdout)


def test_a_second_step_finds_its_memory_where_the_first_left_it() -> None:
    assert page_faults("") > 1000 > 100 > page_faults("keep_freed_memory()")
