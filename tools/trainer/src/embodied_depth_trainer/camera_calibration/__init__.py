"""Calibrates a camera's intrinsics on images of a printed board, and says how certain they are.

No module of this package imports PyTorch, so that the command also runs where the trainer's networks do not.
"""
