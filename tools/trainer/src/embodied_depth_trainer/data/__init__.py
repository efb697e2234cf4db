"""Recordings and datasets as frames with poses in memory, with their coarse depth, labels, pairs and batches."""
