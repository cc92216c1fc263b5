"""The only place that imports rclpy and the generated messages."""
