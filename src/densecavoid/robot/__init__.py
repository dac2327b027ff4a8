"""A body that is a real robot: messages, watchdog, exported folders, nodes for ROS 1 and ROS 2, recordings."""
