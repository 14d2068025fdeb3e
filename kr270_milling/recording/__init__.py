"""Recordings in MCAP: write, read, recover, export; no ROS is imported here."""
