//! What keeps the robot from harm: the bumper between every wish and the wheels.
