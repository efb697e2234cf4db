"""Trains and exports the networks that the robot runs."""

import os

# ONNX Runtime reports to its maker unless this is set before it is loaded.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
