"""Experiments on whole homes: exploration with training in the loop, evaluation on test views, and statistics."""
