"""Runs as datasets of LeRobot, format version 3.0 (`lerobot` 0.4), with images as PNG inside the tables."""
