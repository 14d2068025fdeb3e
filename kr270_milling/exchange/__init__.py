"""Protocols of robot, cut and compensator: records in, records out, without ROS and without a clock."""
