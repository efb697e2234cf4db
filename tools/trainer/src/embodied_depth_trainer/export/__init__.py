"""Trained networks as ONNX files that the robot runs, and the calibration of their confidence."""
