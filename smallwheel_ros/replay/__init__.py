"""Replay of a recorded drive through the node's estimator, without ROS."""
