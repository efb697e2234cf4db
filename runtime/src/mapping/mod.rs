//! What is where: a local occupancy map around the robot.
