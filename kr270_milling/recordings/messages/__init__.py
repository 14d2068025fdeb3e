"""Message bytes to records and back, without ROS."""
