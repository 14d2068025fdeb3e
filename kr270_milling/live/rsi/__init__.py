"""KUKA RobotSensorInterface (RSI) over UDP: corrections in the loop of the controller, Fig. 9(b). No ROS is needed."""
