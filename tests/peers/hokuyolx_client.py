"""Reads a simulated scanner with an independent SCIP client (PyPI `hokuyolx`), which verifies every checksum.

Prints one JSON object with the client's readings. Called by tests/tests/lidar_peer.rs; manually:

    cargo run -p hil -- hokuyo --tcp 10940 --model ust-10lx
    python3 -m venv target/peers && target/peers/bin/pip install -r tests/peers/requirements.txt
    target/peers/bin/python tests/peers/hokuyolx_client.py 127.0.0.1 10940
"""

import itertools
import json
import sys

from hokuyolx import HokuyoLX


def main() -> None:
    # Read one byte at a time: the client reads to the end of a block and discards what it has read beyond it, which on
    # a busy computer was the first scan.
    laser = HokuyoLX(addr=(sys.argv[1], int(sys.argv[2])), convert_time=False, buf=1)
    _, once = laser.get_dist()
    _, intensities = laser.get_intens()
    scans = list(itertools.islice(laser.iter_dist(scans=20), 20))
    stamps = [int(stamp) for _, stamp, _ in scans]
    result = {
        "parameters": laser.sensor_parameters(),
        "version": laser.version(),
        "state": laser.sensor_state(),
        "once": [int(value) for value in once],
        "with_intensities": [int(value) for value in intensities[:, 0]],
        "last": [int(value) for value in scans[-1][0]],
        "left": [int(left) for _, _, left in scans],
        "steps_ms": [after - before for before, after in zip(stamps, stamps[1:])],
    }
    laser.standby()
    laser.close()
    json.dump(result, sys.stdout)


main()
