"""Runs as ROS 2 bags: a directory with `metadata.yaml` and one MCAP file, for `ros2 bag play`, rviz and `rosbags`.

Recordings are MCAP files as well, but with Foxglove's message types, which ROS does not define.
"""
