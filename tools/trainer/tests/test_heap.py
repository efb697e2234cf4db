"""What the heap does with memory that was freed."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import pathlib, resource, torch
from embodied_depth_trainer.heap import keep_freed_memory
{call}
def resident_mib():
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() >> 20
tensor = torch.ones(16 << 20)
before = resident_mib()
del tensor
print(before - resident_mib())
"""


def given_back_mib(call: str) -> int:
    """To the kernel, of a tensor of 64 MiB that was freed."""
    program = [sys.executable, "-c", PROGRAM.format(call=call)]
    return int(subprocess.run(program, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's heap is told to")
def test_what_a_step_frees_stays_for_the_next_one() -> None:
    assert given_back_mib("") > 60
    assert given_back_mib("keep_freed_memory()") < 4
