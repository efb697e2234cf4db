"""Lets `python -m embodied_depth_trainer` run the command line."""

import sys

from embodied_depth_trainer.commands.cli import main

if __name__ == "__main__":
    sys.exit(main())
