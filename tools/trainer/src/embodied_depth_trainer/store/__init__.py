"""The store: what a training reads of recorded segments, made once and kept on the disk."""
