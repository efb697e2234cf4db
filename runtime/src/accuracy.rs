//! Accuracy of depth against ground truth, as the field reports it.
