"""Runs `calibrate-camera` without the other commands, which import PyTorch."""

from __future__ import annotations

import argparse

from embodied_depth_trainer.commands.calibrate_camera import add_calibrate_camera, run_calibrate_camera


def run(*arguments: object) -> None:
    command = argparse.ArgumentParser()
    add_calibrate_camera(command)
    run_calibrate_camera(command.parse_args([str(argument) for argument in arguments]))
