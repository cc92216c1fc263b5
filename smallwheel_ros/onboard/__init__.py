"""Everything between topics and estimates, without ROS: what node and replay share."""
