"""The heap keeps freed memory in the process."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import pathlib, resource, torch
from embodied_depth_trainer.training.heap import keep_freed_memory
{call}
def resident_mib():
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() >> 20
tensor = torch.ones(16 << 20)
before = resident_mib()
del tensor
print(before - resident_mib())
"""


def returned_mib(call: str) -> int:
    """Memory that the process returns to the kernel after freeing a tensor of 64 MiB."""
    program = [sys.executable, "-c", PROGRAM.format(call=call)]
    return int(subprocess.run(program, check=True, capture_output=True, text=True).stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's heap has this setting")
def test_freed_memory_stays_in_the_process() -> None:
    assert returned_mib("") > 60
    assert returned_mib("keep_freed_memory()") < 4
