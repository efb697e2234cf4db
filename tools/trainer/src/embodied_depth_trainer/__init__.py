"""Trains, evaluates and exports the networks that the robot runs."""

import os

__version__ = "0.1.0"

# ONNX Runtime sends telemetry unless this is set before it is loaded.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
