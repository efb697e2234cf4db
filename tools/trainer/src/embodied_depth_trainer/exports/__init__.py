"""Recorded runs in the formats of LeRobot and ROS 2, by the libraries of those formats. Nothing here needs PyTorch."""
