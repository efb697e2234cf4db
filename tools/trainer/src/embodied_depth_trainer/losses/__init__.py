"""The loss terms of training: photometric self-supervision, and agreement with coarse depth, labels and LiDAR."""
